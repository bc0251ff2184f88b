// Lets the page's address have a part after `#`, which viser's client takes away as it starts.
if (location.hash) {
  const hash = location.hash;
  const write = url => History.prototype.replaceState.call(history, history.state, '', url);
  write(location.pathname + location.search);
  history.replaceState = (state, title, url) => {  // viser calls it once, when its socket is named
    delete history.replaceState;
    history.replaceState(state, title, url);
    write(location.pathname + location.search + hash);
  };
}
