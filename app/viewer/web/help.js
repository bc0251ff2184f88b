// viser's dialogs know no keys. The last button of the dialog closes it.
const here = this.parentElement;
document.addEventListener('keydown', function end(event) {
  if (!here.isConnected) document.removeEventListener('keydown', end);
  else if (event.key === 'Escape')
    [...here.closest('[role=dialog]').querySelectorAll('button')].pop().click();
});
