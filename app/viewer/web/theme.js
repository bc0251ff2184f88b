// The page is dark, light, or as its system is: as whoever sits at it has chosen, which this browser
// remembers. It stands before viser's own script, which would set what its server says.
{
  const KEY = 'gpgrad-theme', {documentElement: root} = document;
  const system = matchMedia('(prefers-color-scheme: dark)');
  const read = () => { try { return localStorage.getItem(KEY); } catch { return null; } };
  let chosen = read() ?? 'dark';
  const apply = () => {
    const scheme = chosen === 'system' && !system.matches || chosen === 'light' ? 'light' : 'dark';
    if (root.dataset.mantineColorScheme !== scheme) root.dataset.mantineColorScheme = scheme;
  };
  window.gpgradTheme = {
    get chosen() { return chosen; },
    choose(theme) {
      chosen = theme;
      try { localStorage.setItem(KEY, theme); } catch { /* a private window */ }
      apply();
    },
  };
  system.addEventListener('change', apply);
  new MutationObserver(apply).observe(root, {attributeFilter: ['data-mantine-color-scheme']});
  apply();
}
