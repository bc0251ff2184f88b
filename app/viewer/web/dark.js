// Tells whether the system of whoever sees this page is dark: once, and whenever it changes.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradDark) return;
  const system = window.gpgradDark = matchMedia('(prefers-color-scheme: dark)');
  const say = changed => gpgrad.say('dark', {dark: system.matches, changed}, true);
  system.addEventListener('change', () => say(true));
  say(false);
})()
