// The pair: a strip at the head of the canvas, or on a phone at its foot, for the thumb. Each side
// names a submap, steps to its neighbours, and opens a list that a search narrows. Python says what
// stands on it; see features/chooser.py.
(function run() {
  const over = window.gpgrad && document.querySelector('[data-testid=over-canvas]');
  if (!over) { setTimeout(run, 50); return; }  // the scripts of the canvas may come later
  if (gpgrad.acts.pair) { gpgrad.say('pair', {act: 'here'}); return; }
  const {make} = gpgrad;
  const ground = 'background:color-mix(in srgb,var(--mantine-color-body) 94%,transparent);' +
    'border:1px solid rgba(128,128,128,.45);pointer-events:auto;';
  const bare = 'all:unset;box-sizing:border-box;cursor:pointer;';
  const strip = make(over, 'div', 'position:absolute;top:8px;left:50%;transform:translateX(-50%);' +
    'max-width:calc(100% - 12px);display:none;align-items:stretch;border-radius:.45em;z-index:2;' +
    ground, {role: 'group', 'aria-label': 'Pair', 'data-testid': 'pair-strip'});
  const style = make(over, 'style', '');
  style.textContent = '[data-testid=pair-strip] :is(button,[data-step]):hover{background:' +
    'rgba(128,128,128,.18)}[data-testid=pair-strip] button:focus-visible{outline:2px solid var(--gg-accent);' +
    'outline-offset:-2px}[data-step]{transition:opacity .15s}' +
    // A mouse has the arrows when it is there; a finger cannot come near without pressing.
    '@media (hover:hover) and (min-width:641px){' +
    '[data-testid=pair-strip]:not(:hover,:focus-within) [data-step]{opacity:0}}' +
    '[data-testid=over-canvas]{--head:var(--pair,0px);--foot:var(--strip,0px)}' +
    '@media (max-width:640px){[data-testid=over-canvas]{--head:0px;--foot:calc(var(--strip,0px) + var(--pair,0px))}' +
    '[data-testid=pair-strip]{top:auto!important;bottom:8px}[data-testid=pair-list]{top:6px!important}}' +
    // Beside panels or the matrix there may be room for the names alone.
    '@container (max-width:380px){' +
    '[data-testid=pair-strip] :is([data-step],[data-portrait]){display:none!important}}';
  const chevron = way => '<svg width="12" height="20" viewBox="-6 -10 12 20" fill="none" ' +
    `stroke="currentColor" stroke-width="2"><path d="M${-3 * way}-6L${3 * way} 0L${-3 * way} 6"/></svg>`;
  const portraits = {};  // by the fingerprint of the submap
  const picture = (parent, print) => {
    const made = make(parent, 'span', 'flex:none;width:34px;height:34px;border-radius:.25em;' +
      'background:rgba(128,128,128,.2) center/cover;image-rendering:pixelated',
      {'aria-hidden': 'true'});
    show_picture(made, print);
    return made;
  };
  const show_picture = (part, print) => {
    part.dataset.portrait = print;
    part.style.backgroundImage = portraits[print] ? `url(${portraits[print]})` : '';
  };
  const pair = {}, sides = {};
  for (const [role, title, color, ink] of SIDES) {
    if (role === 'database') {
      const swap = make(strip, 'button', bare + 'flex:none;width:32px;display:grid;' +
        'place-items:center;font-size:13px;border-inline:1px solid rgba(128,128,128,.3)',
        {type: 'button', 'aria-label': 'Swap query and database', title: 'Swap query and database'});
      swap.innerHTML = '<svg width="20" height="16" viewBox="0 0 20 16" fill="none" ' +
        'stroke="currentColor" stroke-width="1.6"><path d="M3 5H17M13 1L17 5L13 9M17 11H3M7 7L3 11' +
        'L7 15"/></svg>';
      swap.onclick = () => gpgrad.say('pair', {act: 'swap'});
    }
    const side = make(strip, 'div', 'display:flex;min-width:0;box-shadow:inset 0 -3px ' + color);
    // Parts of the side, as the arrows of a number box are: on the keyboard, the arrow keys step.
    const step = (act, way) => {
      const made = make(side, 'span', 'flex:none;width:28px;display:grid;place-items:center;' +
        'cursor:pointer;user-select:none', {'aria-hidden': 'true', 'data-step': `${act} ${role}`,
        title: `The ${act} submap as ${role}`});
      made.innerHTML = chevron(way);
      made.onclick = () => gpgrad.say('pair', {act, role});
    };
    step('previous', -1);
    const button = make(side, 'button', bare + 'display:flex;align-items:center;gap:.5em;' +
      'min-width:0;padding:4px 6px 6px', {type: 'button', 'aria-haspopup': 'dialog',
      'aria-expanded': 'false', 'data-role': role, title: `Choose the ${role}`});
    const image = picture(button, '');
    const words = make(button, 'span', 'min-width:0;line-height:1.25;text-align:left');
    make(words, 'span', `display:block;font-size:12px;color:${ink}`).textContent = title;
    const name = make(words, 'span', 'display:block;font-size:13px;font-weight:600;' +
      'overflow:hidden;text-overflow:ellipsis;white-space:nowrap;max-width:14em',
      {'data-testid': `pair-${role}`});
    step('next', 1);
    button.onclick = () => { if (open === role) close(true); else begin(role); };
    button.onkeydown = event => {
      const act = {ArrowLeft: 'previous', ArrowRight: 'next'}[event.key];
      if (act) gpgrad.say('pair', {act, role});
      else if (event.key === 'ArrowDown') begin(role);
      else return;
      event.preventDefault(); event.stopPropagation();  // it would fly the camera too
    };
    sides[role] = {button, image, name, title};
  }
  // The list: one for both sides, and open for one of them.
  let open = '', active = -1, listed = null;
  let aimed = '';  // the submap that the arrow keys point at, whatever list comes meanwhile
  const popup = make(over, 'div', 'position:absolute;top:62px;display:flex;flex-direction:column;' +
    'width:min(250px,calc(100% - 12px));max-height:min(480px,calc(100% - 68px));padding:6px;' +
    'box-sizing:border-box;border-radius:.45em;z-index:3;box-shadow:0 4px 16px rgba(0,0,0,.25);' +
    'background:var(--mantine-color-body);border:1px solid rgba(128,128,128,.45);' +
    'pointer-events:auto', {role: 'dialog', 'data-testid': 'pair-list'});
  const input = make(popup, 'input', 'flex:none;font:inherit;font-size:13px;height:34px;' +
    'padding:0 8px;box-sizing:border-box;width:100%;border:1px solid rgba(128,128,128,.7);' +
    'border-radius:.3em;background:transparent;color:inherit', {type: 'text', role: 'combobox',
    'aria-controls': 'gpgrad-submaps', 'aria-expanded': 'true', 'aria-autocomplete': 'list',
    autocomplete: 'off', spellcheck: 'false', maxlength: 200});
  const list = make(popup, 'div', 'overflow-y:auto;min-height:0;margin-top:4px',
    {role: 'listbox', id: 'gpgrad-submaps', 'aria-label': 'Submaps'});
  const more = make(popup, 'div', 'flex:none;font-size:12px;padding:4px 6px 0',
    {role: 'status', 'data-testid': 'pair-more'});
  popup.remove();  // a dialog is there while it is open: Escape is its own then
  const ask = () => gpgrad.say('pair-search', {role: open, text: input.value}, true);
  const begin = role => {
    open = role; listed = null; active = -1; aimed = ''; input.value = '';
    list.replaceChildren(); more.textContent = '';
    const said = `Choose the ${role}`;
    popup.setAttribute('aria-label', said); input.setAttribute('aria-label', said);
    input.placeholder = `Search ${pair.count} submaps`;
    over.append(popup);
    for (const one in sides) sides[one].button.setAttribute('aria-expanded', one === role);
    const at = sides[role].button.getBoundingClientRect(), box = over.getBoundingClientRect();
    const left = Math.min(at.left - box.left, box.width - popup.offsetWidth - 6);
    popup.style.left = Math.max(left, 6) + 'px';
    ask(); input.focus();
  };
  const close = back => {
    if (!open) return;
    const {button} = sides[open];
    open = '';
    popup.remove();
    for (const one in sides) sides[one].button.setAttribute('aria-expanded', 'false');
    if (back) button.focus();
  };
  const choose = name => {
    gpgrad.say('pair', {act: 'choose', role: open, name});
    close(true);
  };
  const point = place => {
    active = place;
    [...list.children].forEach((row, k) => {
      row.style.background = k === place ? 'rgba(28,126,214,.22)' : '';
    });
    const row = list.children[place];
    input.setAttribute('aria-activedescendant', row ? row.id : '');
    if (!row) return;
    const above = row.offsetTop - list.offsetTop, room = list.clientHeight - row.offsetHeight;
    list.scrollTop = Math.min(Math.max(list.scrollTop, above - room), above);
  };
  gpgrad.acts.choices = data => {
    if (data.role !== open || data.text !== input.value) return;  // of what was typed before
    listed = data.text;
    list.replaceChildren();
    data.found.forEach((name, k) => {
      const row = make(list, 'div', 'display:flex;align-items:center;gap:.6em;padding:3px 6px;' +
        'min-height:40px;box-sizing:border-box;border-radius:.3em;cursor:pointer;font-size:13px',
        {role: 'option', id: `gpgrad-submap-${k}`, 'data-name': name,
        'aria-selected': name === pair[open]});
      picture(row, data.pictures[k]);
      make(row, 'span', 'min-width:0;overflow-wrap:anywhere').textContent = name;
      const other = open === 'query' ? 'database' : 'query';
      const has = name === pair[open] ? open : name === pair[other] ? `${other}: they swap` : '';
      make(row, 'span', 'margin-left:auto;font-size:12px;white-space:nowrap').textContent = has;
      row.onclick = () => choose(name);
      row.onpointermove = () => { if (active !== k) { aimed = ''; point(k); } };
    });
    if (!data.found.includes(aimed)) aimed = '';
    point(aimed ? data.found.indexOf(aimed) : data.found.length ? data.at : -1);
    const chosen = list.children[active];
    if (chosen) list.scrollTop = chosen.offsetTop - list.offsetTop - list.clientHeight / 2;
    more.textContent = data.more ? `and ${data.more} more: type to narrow` :
      data.found.length ? '' : 'No submap has this in its id.';
  };
  const aim = way => {
    const count = list.children.length;
    point((active + way + count) % count);
    aimed = list.children[active].dataset.name;
  };
  // In a list of what was typed before, the arrow keys may point at one that is not sought now.
  const fits = name => name && name.toLowerCase().includes(input.value.trim().toLowerCase());
  input.oninput = () => { aimed = ''; ask(); };
  popup.onkeydown = event => {
    event.stopPropagation();  // keys are for the list now
    const count = list.children.length;
    if (event.key === 'Escape') close(true);
    else if (event.key === 'Tab') { close(true); return; }
    else if (event.key === 'ArrowDown' && count) aim(1);
    else if (event.key === 'ArrowUp' && count) aim(-1);
    else if (event.key === 'Enter' && fits(aimed)) choose(aimed);
    else if (event.key === 'Enter' && listed !== input.value) choose(input.value);
    else if (event.key === 'Enter') list.children[active]?.click();
    else return;
    event.preventDefault();
  };
  window.addEventListener('pointerdown', event => {
    if (open && !popup.contains(event.target) && !strip.contains(event.target)) close(false);
  }, true);
  gpgrad.acts.portraits = data => {
    Object.assign(portraits, data);
    for (const part of over.querySelectorAll('[data-portrait]'))
      if (part.dataset.portrait in data) show_picture(part, part.dataset.portrait);
  };
  gpgrad.acts.pair = data => {
    if (!data.shown) close(false);
    Object.assign(pair, data);
    strip.style.display = data.shown ? 'flex' : 'none';
    over.style.setProperty('--pair', data.shown ? strip.offsetHeight + 6 + 'px' : '0px');
    window.gpgradCanvas.named = data.shown;  // so the caption need not
    window.gpgradCanvas.tell();
    for (const role in sides) {
      const {button, image, name, title} = sides[role];
      name.textContent = data[role]; name.title = data[role];
      button.setAttribute('aria-label', `${title} ${data[role]}. Choose another, or step with ` +
        'the arrow keys');
      show_picture(image, data.pictures[role]);
    }
  };
  gpgrad.say('pair', {act: 'here'});
})()
