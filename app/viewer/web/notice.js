// viser warns over the picture that there is no graphics card. Here that is a line at the foot of the
// page, below the panels, until it is dismissed, which this browser remembers.
{
  const KEY = 'gpgrad-no-graphics-card', RENDERER = 0x9246;  // UNMASKED_RENDERER_WEBGL
  const context = WebGL2RenderingContext.prototype, {getParameter} = context;
  const software = /swiftshader|llvmpipe|softpipe|software/i;
  const tell = () => {
    try { if (localStorage.getItem(KEY)) return; } catch { /* a private window */ }
    if (document.querySelector('[data-testid=no-graphics-card]')) return;
    const line = document.createElement('div'), close = document.createElement('button');
    line.dataset.testid = 'no-graphics-card';
    line.append('Drawn without a graphics card, so slower. ', close);
    line.style.cssText = 'position:fixed;right:16px;bottom:24px;color:var(--gg-dim);font-size:12px';
    close.textContent = '×';
    close.setAttribute('aria-label', 'Dismiss');
    close.style.cssText = 'font:inherit;color:inherit;background:none;border:0;cursor:pointer;' +
      'padding:4px 8px';
    close.addEventListener('click', () => {
      line.remove();
      try { localStorage.setItem(KEY, 'dismissed'); } catch { /* a private window */ }
    });
    document.body.append(line);
  };
  context.getParameter = function (name) {
    const value = getParameter.call(this, name);
    if (name !== RENDERER || !software.test(value)) return value;
    tell();
    return 'no graphics card';
  };
}
