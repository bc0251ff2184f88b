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
  // The button of viser's settings, which look.css draws, opens the choice.
  const close = () => document.querySelector('[data-testid=theme-menu]')?.remove();
  const open = button => {
    const menu = document.createElement('div'), box = button.getBoundingClientRect();
    menu.dataset.testid = 'theme-menu';
    menu.setAttribute('role', 'menu');
    menu.style.cssText = 'position:fixed;z-index:300;display:grid;padding:4px;border-radius:8px;' +
      'background:var(--gg-surface);box-shadow:var(--gg-shadow);font-size:13px;' +
      `top:${box.bottom + 4}px;right:${innerWidth - box.right}px`;
    for (const theme of ['dark', 'light', 'system']) {
      const item = document.createElement('button'), is = theme === chosen;
      item.textContent = `${is ? '●' : '○'} ${theme[0].toUpperCase()}${theme.slice(1)}`;
      item.setAttribute('role', 'menuitemradio');
      item.setAttribute('aria-checked', is);
      item.style.cssText = 'font:inherit;text-align:left;padding:8px 16px;border:0;cursor:pointer;' +
        `border-radius:6px;background:none;color:var(${is ? '--gg-accent' : '--gg-text'})`;
      item.addEventListener('click', () => gpgradTheme.choose(theme));
      menu.append(item);
    }
    document.body.append(menu);
    menu.querySelector('[aria-checked=true]').focus();
  };
  document.addEventListener('click', event => {
    const button = event.target.closest?.(VISER_ICON_BUTTON);
    const was = document.querySelector('[data-testid=theme-menu]');
    close();
    if (!button?.querySelector(VISER_SETTINGS_ICON)) return;
    event.stopPropagation();
    if (!was) open(button);
  }, true);
  document.addEventListener('keydown', event => { if (event.key === 'Escape') close(); });
  new MutationObserver(apply).observe(root, {attributeFilter: ['data-mantine-color-scheme']});
  apply();
}
