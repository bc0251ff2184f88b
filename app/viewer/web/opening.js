// Says in the middle of the page what is done while a dataset is opened, and how far it is.
{
  const shown = document.getElementById('gpgrad-opening');
  if (shown) {
    shown.querySelector('span').textContent = WORDS;
    shown.querySelector('i').style.width = 100 * SHARE + '%';
    shown.classList.toggle('low', LOW);
  }
}
