// Opens what is dropped anywhere on the page. A zip or a cloud is sent as it is. A folder, or several
// files, go as one file: a line of JSON with names and sizes, and their contents one after the other.
// All take the way of the hidden upload button BUTTON, past its checks.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  const own = window.gpgradDrop ??= {};
  own.button = BUTTON;
  if (own.cover) return;
  const cover = own.cover = document.createElement('div');
  cover.dataset.testid = 'drop';
  cover.textContent = 'Drop a dataset folder, a .zip or clouds to open them';
  cover.style.cssText = 'position:fixed;inset:12px;z-index:2000;display:none;pointer-events:none;' +
    'align-items:center;justify-content:center;border:3px dashed var(--gg-accent);border-radius:12px;' +
    'background:color-mix(in srgb,var(--mantine-color-body) 85%,transparent);' +
    'color:var(--mantine-color-text);font:600 20px/1.4 var(--mantine-font-family)';
  document.body.appendChild(cover);
  const shows = on => { cover.style.display = on ? 'flex' : 'none'; };
  const ending = name => (name.match(/\.[^.]*$/) || [''])[0].toLowerCase();
  const listed = reader => new Promise((done, fail) => reader.readEntries(done, fail));
  const walk = async (entry, path, found) => {
    if (entry.name.startsWith('.') || found.length > MOST_FILES) return;
    if (entry.isFile) {
      const file = await new Promise((done, fail) => entry.file(done, fail));
      // What is no part of a dataset is counted, and not sent.
      found.push([path + entry.name, KNOWN.includes(ending(entry.name)) ? file : new Blob()]);
      return;
    }
    const reader = entry.createReader();
    for (let some = await listed(reader); some.length; some = await listed(reader))
      for (const one of some) await walk(one, path + entry.name + '/', found);
  };
  const open = async (entries, files) => {
    const [first] = entries, alone = entries.length === 1 && first.isFile;
    let sent = files[0];
    if (!alone) {
      const found = [];
      for (const entry of entries) await walk(entry, '', found);
      if (found.length > MOST_FILES) return {name: first.name, files: found.length, bytes: 0};
      const head = JSON.stringify(found.map(([path, file]) => [path, file.size])) + '\n';
      const name = first.isFile ? 'dropped clouds' : first.name;
      sent = new File([head, ...found.map(([, file]) => file)], name + PACKED);
    } else if (![...KNOWN, '.zip'].includes(ending(first.name))) {
      return {name: first.name, files: 1, bytes: 0};
    }
    const told = {name: alone ? first.name : sent.name.slice(0, -PACKED.length), files: 1};
    const input = document.getElementById('file_upload_' + own.button);
    if (sent.size > MOST_BYTES || !input) return {...told, bytes: sent.size};
    const given = new DataTransfer();
    given.items.add(sent);
    input.files = given.files;
    input.dispatchEvent(new Event('change', {bubbles: true}));
    return null;
  };
  const has_files = event => [...(event.dataTransfer?.types ?? [])].includes('Files');
  window.addEventListener('dragover', event => {
    if (!has_files(event)) return;
    event.preventDefault();
    shows(true);
  });
  window.addEventListener('dragleave', event => { if (!event.relatedTarget) shows(false); });
  window.addEventListener('drop', event => {
    if (!has_files(event)) return;
    event.preventDefault();
    shows(false);
    // Both are gone once this handler has ended.
    const entries = [...event.dataTransfer.items].map(item => item.webkitGetAsEntry?.())
      .filter(entry => entry);
    const files = [...event.dataTransfer.files];
    if (!entries.length) return;
    open(entries, files).then(
      refused => { if (refused) gpgrad.say('not dropped', refused); },
      () => gpgrad.say('not dropped', {name: entries[0].name, files: 0, bytes: 0}));
  });
})()
