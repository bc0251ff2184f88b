// Tells when the flat picture comes into view, and when it goes. A pixel above it is watched: viser
// puts a new picture there for each one that is drawn.
const mark = this.parentElement.querySelector('[data-testid=flat-picture]');
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  new IntersectionObserver(all => gpgrad.say(SEEN,
    {seen: all[all.length - 1].isIntersecting}, true)).observe(mark);
})()
