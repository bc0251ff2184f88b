// Keeps the page's address as viser's client starts. It takes away what is behind `#`; and as the page
// of one who works alone has a path, it takes its server for a strange one and writes that down. It
// does so once or, where the browser is slow, more often, and later too: only the first time counts.
{
  const {hash, pathname, search} = location;
  const write = url => History.prototype.replaceState.call(history, history.state, '', url);
  write(pathname + search);  // the client reads its server from the address
  let started = false;
  history.replaceState = () => {
    if (!started) write(pathname + search + hash);
    started = true;
  };
}
