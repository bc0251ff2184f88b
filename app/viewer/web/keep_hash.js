// Keeps the page's address as viser's client starts. It takes away what is behind `#`; and as the page
// of one who works alone has a path, it takes its server for a strange one and writes that down.
if (location.hash || location.pathname !== '/') {
  const {hash, pathname, search} = location;
  const write = url => History.prototype.replaceState.call(history, history.state, '', url);
  write(pathname + search);
  history.replaceState = (state, title, url) => {  // viser calls it once, when its socket is named
    delete history.replaceState;
    history.replaceState(state, title, url);
    write(pathname + search + hash);
  };
}
