// The page of a dataset, or of one pair. All data are in the page; nothing is asked of any server.
// One threshold is shared by the matrix, the curve, the histogram, the list, the time line and the
// map; one pair is chosen, and shown in three dimensions.
(async () => {
  'use strict';
  const at = id => document.getElementById(id);
  const ACCEPTED = 1, BARRED = 2, TRUE = 4, FALSE = 8, RIGHT = 16, DROPPED = 32, CONFIRMED = 64; // as in page.py
  const MOST_ROWS = 500;
  const content = JSON.parse(at('content').textContent);
  const submaps = content.submaps;
  const whole = content.poses !== null;

  const fail = words => {
    at('failure').textContent = words;
    at('failure').hidden = false;
  };
  if (!('DecompressionStream' in window)) {
    fail('This browser is too old to unpack the data of this page: it needs one of 2023 or newer.');
    return;
  }

  // --- what was packed --------------------------------------------------------------------------
  const arrays = await (async () => {
    const letters = atob(at('arrays').textContent);
    at('arrays').textContent = '';
    const packed = Uint8Array.from(letters, letter => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
    const bytes = await new Response(stream).arrayBuffer();
    const kinds = {
      uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, float32: Float32Array, float64: Float64Array,
    };
    const found = {};
    let start = 0;
    for (const [name, kind, length] of content.arrays) {
      const array = new kinds[kind](bytes.slice(start, start + length)); // long floats begin anywhere
      (found[name] = found[name] || []).push(array);
      start += length + (4 - length % 4) % 4;
    }
    return found;
  })();
  const [query, database, inliers, state, score, area, xs, ys, yaws, zs] =
    ['query', 'database', 'inliers', 'state', 'score', 'area', 'x', 'y', 'yaw', 'z']
      .map(name => arrays[name][0]);
  const count = query.length;
  const keyOf = (a, b) => a * submaps.length + b;
  const rowOf = new Map();
  for (let k = 0; k < count; k++) {
    rowOf.set(keyOf(query[k], database[k]), k);
    rowOf.set(keyOf(database[k], query[k]), k);
  }
  const reasons = new Map(content.reasons.map(([a, b, text]) => [keyOf(a, b), text]));
  const lines = new Map(content.lines.map(([a, b, k]) => [keyOf(a, b), arrays.line[k]]));

  const terrains = [];
  // Heights [m] of a submap, row by row, with NaN where nothing is known.
  const heightsOf = k => {
    if (terrains[k]) return terrains[k];
    const {rows, columns, base, step} = submaps[k];
    const planes = arrays.heights[k], known = arrays.known[k], cells = rows * columns;
    const heights = new Float32Array(cells);
    for (let row = 0, i = 0; row < rows; row++) {
      for (let column = 0, value = 0; column < columns; column++, i++) {
        const folded = planes[i] | planes[cells + i] << 8;
        value += folded >>> 1 ^ -(folded & 1);
        heights[i] = known[i >> 3] >> (i & 7) & 1 ? base + step * value : NaN;
      }
    }
    terrains[k] = heights;
    return heights;
  };
  // Height between the cells, or NaN beside what is known.
  const heightAt = (k, x, y) => {
    const {rows, columns, cell, x: left, y: low} = submaps[k], heights = heightsOf(k);
    const u = (x - left) / cell, v = (y - low) / cell, i = Math.floor(u), j = Math.floor(v);
    if (i < 0 || j < 0 || i >= columns - 1 || j >= rows - 1) return NaN;
    const n = j * columns + i, s = u - i, t = v - j;
    return (heights[n] * (1 - s) + heights[n + 1] * s) * (1 - t)
      + (heights[n + columns] * (1 - s) + heights[n + columns + 1] * s) * t;
  };

  // --- what is chosen ---------------------------------------------------------------------------
  const chosen = {
    threshold: content.threshold, pair: -1, time: submaps.length,
    shift: content.poses && content.poses.after ? 1 : 0,
  };
  const finite = k => Number.isFinite(xs[k]);
  const closes = k => Boolean(state[k] & CONFIRMED)
    || score[k] >= chosen.threshold && !(state[k] & BARRED) && finite(k)
    || Boolean(state[k] & ACCEPTED) && chosen.threshold <= content.threshold;
  let closing = [];
  const judge = () => {
    closing = [];
    for (let k = 0; k < count; k++) if (closes(k)) closing.push(k);
    closing.sort((a, b) => score[b] - score[a]);
  };
  const bend = value => Math.sign(value) * Math.log1p(Math.abs(value));
  const unbend = value => Math.sign(value) * Math.expm1(Math.abs(value));
  let lowest = 0, highest = bend(content.threshold);
  for (let k = 0; k < count; k++) {
    lowest = Math.min(lowest, bend(score[k]));
    highest = Math.max(highest, bend(score[k]));
  }
  highest += 0.02 * (highest - lowest) + 0.01;
  // Rounded down, so that a score does not read as the threshold that it misses.
  const number = value => {
    const nearest = value.toFixed(2);
    return nearest <= value ? nearest : (nearest - 0.01).toFixed(2);
  };
  const plural = (n, what) => `${n.toLocaleString('en')} ${what}${n === 1 ? '' : 's'}`;

  // --- pictures in two dimensions ---------------------------------------------------------------
  let colours = {};
  const readColours = () => {
    const probe = document.createElement('span');
    document.body.append(probe);
    for (const name of ['ground', 'panel', 'text', 'faint', 'line', 'accent', 'true', 'false', 'unknown']) {
      probe.style.color = `var(--${name})`;
      colours[name] = getComputedStyle(probe).color;
    }
    probe.remove();
  };
  const begin = canvas => {
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext('2d');
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = '12px system-ui, sans-serif';
    return {pen, width, height};
  };
  const place = (canvas, event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  // What a pair is told to be by the truth, as a colour.
  const truthOf = k => state[k] & TRUE ? 'true' : state[k] & FALSE ? 'false' : 'unknown';
  const colourOf = k => content.curve ? colours[truthOf(k)] : colours.accent;
  const pending = new Set();
  const draw = (...pictures) => {
    if (!pending.size) requestAnimationFrame(() => {
      const due = [...pending];
      pending.clear();
      for (const picture of due) picture();
    });
    for (const picture of pictures) pending.add(picture);
  };

  // --- the map ----------------------------------------------------------------------------------
  const map = {rasters: {}};
  const mixed = shift => {
    const {before, after} = content.poses;
    if (!after || shift === 0) return before;
    if (shift === 1) return after;
    return before.map((pose, k) => pose.map((value, i) => {
      let change = after[k][i] - value;
      if (i === 2) change = Math.atan2(Math.sin(change), Math.cos(change));
      return value + shift * change;
    }));
  };
  // The merged terrain at the poses: means of the heights, shaded; and the first submap that saw
  // each cell, by which the map grows along the time line.
  const rasterOf = poses => {
    let left = Infinity, right = -Infinity, low = Infinity, high = -Infinity, finest = 0;
    const boxes = submaps.map((submap, k) => {
      const [x, y, yaw] = poses[k], c = Math.cos(yaw), s = Math.sin(yaw);
      const box = [Infinity, -Infinity, Infinity, -Infinity];
      for (const u of [submap.x, submap.x + submap.cell * (submap.columns - 1)]) {
        for (const v of [submap.y, submap.y + submap.cell * (submap.rows - 1)]) {
          const wx = x + c * u - s * v, wy = y + s * u + c * v;
          box[0] = Math.min(box[0], wx); box[1] = Math.max(box[1], wx);
          box[2] = Math.min(box[2], wy); box[3] = Math.max(box[3], wy);
        }
      }
      left = Math.min(left, box[0]); right = Math.max(right, box[1]);
      low = Math.min(low, box[2]); high = Math.max(high, box[3]);
      finest = Math.max(finest, submap.cell);
      return box;
    });
    const side = Math.max(finest, Math.sqrt((right - left) * (high - low) / 1.2e6));
    const columns = Math.ceil((right - left) / side) + 1, rows = Math.ceil((high - low) / side) + 1;
    const sums = new Float32Array(columns * rows), weights = new Float32Array(columns * rows);
    const first = new Uint16Array(columns * rows).fill(65535);
    submaps.forEach((submap, k) => {
      const [x, y, yaw, z] = poses[k], c = Math.cos(yaw), s = Math.sin(yaw), box = boxes[k];
      const middleX = submap.x + submap.cell * submap.columns / 2;
      const middleY = submap.y + submap.cell * submap.rows / 2;
      const reach = submap.cell * Math.max(submap.columns, submap.rows) / 2;
      for (let j = Math.floor((box[2] - low) / side); j * side + low <= box[3]; j++) {
        for (let i = Math.floor((box[0] - left) / side); i * side + left <= box[1]; i++) {
          const dx = left + i * side - x, dy = low + j * side - y;
          const u = c * dx + s * dy, v = c * dy - s * dx, height = heightAt(k, u, v);
          if (Number.isNaN(height)) continue;
          const far = Math.hypot(u - middleX, v - middleY) / reach, n = j * columns + i;
          const weight = Math.max(1 - far, 0.02); // so that no edge is seen where all agrees
          sums[n] += weight * (height + z);
          weights[n] += weight;
          if (k < first[n]) first[n] = k;
        }
      }
    });
    let bottom = Infinity, top = -Infinity;
    for (let n = 0; n < sums.length; n++) {
      sums[n] = weights[n] ? sums[n] / weights[n] : NaN;
      if (sums[n] < bottom) bottom = sums[n];
      if (sums[n] > top) top = sums[n];
    }
    const picture = new ImageData(columns, rows), pixels = picture.data;
    const steep = 1.6; // slopes are drawn steeper than they are, so that bare ground shows its form
    for (let j = 0; j < rows; j++) {
      for (let i = 0; i < columns; i++) {
        const n = j * columns + i, height = sums[n];
        if (Number.isNaN(height)) continue;
        const rise = (a, b) => {
          const value = (sums[b] - sums[a]) / side;
          return Number.isNaN(value) ? 0 : value;
        };
        const gx = steep * (i && i < columns - 1 ? rise(n - 1, n + 1) / 2 : 0);
        const gy = steep * (j && j < rows - 1 ? rise(n - columns, n + columns) / 2 : 0);
        const light = Math.max(0, (0.5 * gx - 0.5 * gy + 0.707) / Math.sqrt(1 + gx * gx + gy * gy));
        const share = (height - bottom) / (top - bottom || 1), pixel = 4 * ((rows - 1 - j) * columns + i);
        const shade = 0.25 + light;
        pixels[pixel] = Math.min(255, shade * (120 + 85 * share));
        pixels[pixel + 1] = Math.min(255, shade * (126 + 60 * share));
        pixels[pixel + 2] = Math.min(255, shade * (134 + 10 * share));
        pixels[pixel + 3] = 255;
      }
    }
    const canvas = document.createElement('canvas');
    canvas.width = columns;
    canvas.height = rows;
    return {picture, first, canvas, left, low, side, columns, rows, drawn: -1};
  };
  const raster = name => {
    if (!map.rasters[name]) map.rasters[name] = rasterOf(content.poses[name]);
    const made = map.rasters[name];
    if (made.drawn !== chosen.time) { // what was not seen yet is left out
      const {picture, first, columns, rows} = made;
      for (let j = 0; j < rows; j++) {
        for (let i = 0; i < columns; i++) {
          const seen = first[j * columns + i] < chosen.time;
          picture.data[4 * ((rows - 1 - j) * columns + i) + 3] = seen ? 255 : 0;
        }
      }
      made.canvas.getContext('2d').putImageData(picture, 0, 0);
      made.drawn = chosen.time;
    }
    return made;
  };
  const drawMap = () => {
    const canvas = at('map'), {pen, width, height} = begin(canvas);
    const {before, after, truth, known} = content.poses, shift = chosen.shift;
    const shown = [];
    if (shift < 1) shown.push([raster('before'), 1 - shift]);
    if (shift > 0) shown.push([raster('after'), shift]);
    let left = Infinity, right = -Infinity, low = Infinity, high = -Infinity;
    for (const made of [map.rasters.before, map.rasters.after]) {
      if (!made) continue;
      left = Math.min(left, made.left); right = Math.max(right, made.left + made.side * made.columns);
      low = Math.min(low, made.low); high = Math.max(high, made.low + made.side * made.rows);
    }
    for (const [x, y] of before) { // its terrain is merged only when it is looked at
      left = Math.min(left, x); right = Math.max(right, x);
      low = Math.min(low, y); high = Math.max(high, y);
    }
    const scale = Math.min((width - 16) / (right - left), (height - 16) / (high - low));
    const offX = (width - scale * (right - left)) / 2, offY = (height - scale * (high - low)) / 2;
    const X = x => offX + scale * (x - left), Y = y => offY + scale * (high - y);
    for (const [made, alpha] of shown) {
      pen.globalAlpha = alpha;
      pen.drawImage(made.canvas, X(made.left), Y(made.low + made.side * made.rows),
        scale * made.side * made.columns, scale * made.side * made.rows);
    }
    pen.globalAlpha = 1;
    const track = (poses, colour, dash, wide, until) => {
      for (const [wider, ink] of [[wide + 2, colours.ground], [wide, colour]]) {
        pen.beginPath();
        pen.setLineDash(dash);
        pen.lineWidth = wider;
        pen.strokeStyle = ink;
        let drawing = false;
        for (let k = 0; k < until; k++) {
          if (!poses[k]) { drawing = false; continue; }
          const [x, y] = poses[k];
          if (submaps[k].starts || !drawing) pen.moveTo(X(x), Y(y));
          else pen.lineTo(X(x), Y(y));
          drawing = true;
        }
        pen.stroke();
      }
      pen.setLineDash([]);
    };
    const poses = mixed(shift);
    if (known) {
      if (truth) track(truth, colours.true, [2, 4], 2, chosen.time);
      if (after && shift > 0) track(before, colours.unknown, [6, 4], 1.5, chosen.time);
      track(poses, colours.accent, [], 2.5, chosen.time);
    }
    map.closures = [];
    for (const k of [...closing].reverse()) {
      if (query[k] >= chosen.time || database[k] >= chosen.time) continue;
      const [a, b] = [poses[query[k]], poses[database[k]]];
      const line = [X(a[0]), Y(a[1]), X(b[0]), Y(b[1]), k];
      map.closures.push(line);
      pen.beginPath();
      pen.setLineDash(state[k] & DROPPED ? [3, 3] : []);
      pen.lineWidth = k === chosen.pair ? 5 : 1.8;
      pen.strokeStyle = colourOf(k);
      pen.moveTo(line[0], line[1]);
      pen.lineTo(line[2], line[3]);
      pen.stroke();
    }
    pen.setLineDash([]);
    map.places = poses.slice(0, chosen.time).map(([x, y]) => [X(x), Y(y)]);
    map.places.forEach(([x, y], k) => {
      const last = k === chosen.time - 1 && chosen.time < submaps.length;
      const role = chosen.pair < 0 ? '' : k === query[chosen.pair] ? '#1f77c8'
        : k === database[chosen.pair] ? '#de7814' : '';
      pen.beginPath();
      pen.arc(x, y, role || last ? 6 : 2.6, 0, 2 * Math.PI);
      pen.fillStyle = role || (last ? colours.text : colours.accent);
      pen.fill();
      if (role || last) { pen.lineWidth = 2; pen.strokeStyle = colours.ground; pen.stroke(); }
    });
    // A bar of a round length.
    const about = 90 / scale, power = 10 ** Math.floor(Math.log10(about));
    const length = power * [1, 2, 5].filter(times => times * power <= about).pop();
    pen.fillStyle = colours.ground;
    pen.globalAlpha = 0.75;
    pen.fillRect(6, height - 30, scale * length + 16, 26);
    pen.globalAlpha = 1;
    pen.fillStyle = colours.text;
    pen.fillRect(14, height - 11, scale * length, 3);
    pen.fillText(`${length} m`, 14, height - 15);
    canvas.dataset.closures = map.closures.length;
    canvas.dataset.shift = shift;
  };
  const drawTimeLine = () => {
    const {pen, width, height} = begin(at('time-line')), n = submaps.length;
    const X = k => 8 + (width - 16) * (n > 1 ? k / (n - 1) : 0.5), base = height - 14;
    for (const k of [...closing].reverse()) {
      const a = X(query[k]), b = X(database[k]), late = Math.max(query[k], database[k]) >= chosen.time;
      pen.beginPath();
      pen.globalAlpha = k === chosen.pair ? 1 : late ? 0.12 : 0.55;
      pen.lineWidth = k === chosen.pair ? 3 : 1;
      pen.strokeStyle = colourOf(k);
      pen.ellipse((a + b) / 2, base, Math.abs(a - b) / 2,
        8 + (base - 12) * Math.abs(query[k] - database[k]) / n, 0, Math.PI, 0);
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.fillStyle = colours.faint;
    for (let k = 0; k < n; k++) pen.fillRect(X(k) - 0.75, base - 3, 1.5, submaps[k].starts ? 12 : 6);
    pen.fillStyle = colours.accent;
    pen.beginPath();
    pen.arc(X(chosen.time - 1), base, 5, 0, 2 * Math.PI);
    pen.fill();
  };

  // --- scores -----------------------------------------------------------------------------------
  const axis = {left: 40, right: 12, top: 10, bottom: 34};
  const drawHistogram = () => {
    const canvas = at('histogram'), {pen, width, height} = begin(canvas);
    const bins = 48, wide = (width - axis.left - axis.right) / bins;
    const stacks = Array.from({length: bins}, () => ({true: 0, false: 0, unknown: 0}));
    for (let k = 0; k < count; k++) {
      const bin = Math.floor(bins * (bend(score[k]) - lowest) / (highest - lowest));
      stacks[Math.max(0, Math.min(bins - 1, bin))][truthOf(k)]++;
    }
    const most = Math.max(1, ...stacks.map(s => s.true + s.false + s.unknown));
    const floor = height - axis.bottom, tall = floor - axis.top;
    const Y = n => floor - tall * Math.sqrt(n / most); // so that a single pair can still be seen
    stacks.forEach((stack, bin) => {
      let below = 0;
      for (const kind of ['true', 'unknown', 'false']) {
        const above = below + stack[kind];
        if (!stack[kind]) continue;
        pen.fillStyle = kind === 'unknown' && !content.curve ? colours.accent : colours[kind];
        pen.fillRect(axis.left + bin * wide, Y(above), Math.max(wide - 1, 1), Y(below) - Y(above));
        below = above;
      }
    });
    pen.fillStyle = colours.faint;
    pen.textAlign = 'right';
    for (const n of new Set([0, Math.round(most / 4), most])) pen.fillText(n.toLocaleString('en'), axis.left - 5, Y(n) + 4);
    pen.textAlign = 'center';
    const X = value => axis.left + (width - axis.left - axis.right) * (bend(value) - lowest) / (highest - lowest);
    let free = -Infinity;
    for (const value of [-30, -3, 0, 1, 3, 10, 30, 100, 300, 1000, 10000]) {
      if (bend(value) < lowest || bend(value) > highest || X(value) < free) continue;
      pen.fillText(value, X(value), floor + 14);
      free = X(value) + 30;
    }
    pen.fillText('score', axis.left + (width - axis.left - axis.right) / 2, height - 4);
    pen.fillRect(axis.left, floor, width - axis.left - axis.right, 1);
    pen.fillStyle = colours.text;
    pen.fillRect(X(chosen.threshold) - 1, axis.top, 2, tall);
    pen.beginPath();
    pen.arc(X(chosen.threshold), axis.top, 6, 0, 2 * Math.PI);
    pen.fill();
    pen.textAlign = 'left';
  };
  const drawMatrix = () => {
    const canvas = at('matrix'), {pen, width, height} = begin(canvas), n = submaps.length;
    const picture = new ImageData(n, n), inks = picture.data;
    const ink = name => colours[name].match(/[\d.]+/g).slice(0, 3).map(Number);
    const [ground, unknown, accent, right, wrong] = ['ground', 'unknown', 'accent', 'true', 'false'].map(ink);
    const put = (i, j, colour, share) => {
      const pixel = 4 * ((n - 1 - j) * n + i);
      for (let c = 0; c < 3; c++) inks[pixel + c] = ground[c] + share * (colour[c] - ground[c]);
      inks[pixel + 3] = 255;
    };
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) put(i, j, i === j ? unknown : ground, i === j ? 0.6 : 1);
    for (let k = 0; k < count; k++) {
      const share = Math.max(0, Math.min(1, bend(score[k]) / Math.max(highest, 0.1)));
      const early = Math.min(query[k], database[k]), late = Math.max(query[k], database[k]);
      const told = content.curve && state[k] & (TRUE | FALSE);
      const colour = !closes(k) ? unknown : told ? state[k] & TRUE ? right : wrong : accent;
      put(late, early, colour, closes(k) ? 0.55 + 0.45 * share : 0.08 + 0.6 * share);
      if (content.curve && state[k] & TRUE) put(early, late, right, 0.9);
    }
    const small = document.createElement('canvas');
    small.width = small.height = n;
    small.getContext('2d').putImageData(picture, 0, 0);
    const side = Math.min(width, height) - 26, left = 22 + (width - 26 - side) / 2;
    map.matrix = {left, top: 2, side};
    pen.imageSmoothingEnabled = n > side;
    pen.drawImage(small, left, 2, side, side);
    pen.strokeStyle = colours.line;
    pen.strokeRect(left, 2, side, side);
    if (chosen.pair >= 0) {
      const cell = side / n, late = Math.max(query[chosen.pair], database[chosen.pair]);
      const early = Math.min(query[chosen.pair], database[chosen.pair]), size = Math.max(cell, 7);
      pen.lineWidth = 2;
      pen.strokeStyle = colours.text;
      pen.strokeRect(left + cell * (late + 0.5) - size / 2, 2 + side - cell * (early + 0.5) - size / 2, size, size);
      pen.lineWidth = 1;
    }
    pen.fillStyle = colours.faint;
    pen.textAlign = 'center';
    pen.fillText('submap', left + side / 2, side + 18);
    pen.save();
    pen.translate(left - 8, 2 + side / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText('earlier submap', 0, 0);
    pen.restore();
    pen.textAlign = 'left';
  };
  const curve = (() => {
    if (!content.curve) return null;
    const judged = [];
    for (let k = 0; k < count; k++) if (state[k] & (TRUE | FALSE)) judged.push(k);
    judged.sort((a, b) => score[b] - score[a]);
    const points = [];
    let hits = 0;
    judged.forEach((k, rank) => {
      if (state[k] & TRUE) hits++;
      const next = judged[rank + 1]; // pairs of one score are taken together
      if (next === undefined || score[next] < score[k]) {
        points.push([hits / Math.max(content.curve.true, 1), hits / (rank + 1), score[k]]);
      }
    });
    return points;
  })();
  const operating = () => curve.filter(point => point[2] >= chosen.threshold).pop();
  const curveAxes = (width, height) => [
    recall => axis.left + (width - axis.left - axis.right) * recall,
    precision => axis.top + (height - axis.top - axis.bottom) * (1 - precision),
  ];
  const drawCurve = () => {
    if (!curve) return;
    const canvas = at('curve'), {pen, width, height} = begin(canvas), [X, Y] = curveAxes(width, height);
    pen.fillStyle = colours.faint;
    pen.strokeStyle = colours.line;
    for (const share of [0, 0.25, 0.5, 0.75, 1]) {
      pen.beginPath();
      pen.moveTo(X(0), Y(share)); pen.lineTo(X(1), Y(share));
      pen.moveTo(X(share), Y(0)); pen.lineTo(X(share), Y(1));
      pen.stroke();
      pen.textAlign = 'right';
      pen.fillText(share, X(0) - 5, Y(share) + 4);
      pen.textAlign = share === 1 ? 'right' : 'center';
      pen.fillText(share, X(share), Y(0) + 14);
    }
    pen.textAlign = 'center';
    pen.fillText('recall', (X(0) + X(1)) / 2, height - 4);
    pen.save();
    pen.translate(10, (Y(0) + Y(1)) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText('precision', 0, 0);
    pen.restore();
    pen.textAlign = 'left';
    pen.beginPath();
    pen.lineWidth = 2.5;
    pen.strokeStyle = colours.accent;
    curve.forEach(([recall, precision], k) => {
      if (!k) pen.moveTo(X(0), Y(precision));
      pen.lineTo(X(recall), Y(precision));
    });
    pen.stroke();
    pen.lineWidth = 1;
    const point = operating();
    if (point) {
      pen.beginPath();
      pen.arc(X(point[0]), Y(point[1]), 6, 0, 2 * Math.PI);
      pen.fillStyle = colours.text;
      pen.fill();
    }
    at('curve-legend').textContent = (point
      ? `At this threshold: precision ${point[1].toFixed(3)}, recall ${point[0].toFixed(3)}. `
      : 'No pair reaches this threshold. ')
      + (content.curve.average === null ? '' : `Average precision ${content.curve.average.toFixed(3)}. `)
      + content.curve.rule;
  };
  const drawList = () => {
    const rows = closing.slice(0, MOST_ROWS).map(k => {
      const row = document.createElement('tr');
      row.tabIndex = 0;
      row.dataset.row = k;
      row.setAttribute('aria-selected', k === chosen.pair);
      const cells = [submaps[query[k]].id, submaps[database[k]].id, number(score[k]), inliers[k],
        finite(k) ? `${xs[k].toFixed(2)}, ${ys[k].toFixed(2)} m` : '',
        finite(k) ? `${(yaws[k] * 180 / Math.PI).toFixed(1)}°` : ''];
      if (content.curve) {
        const told = {true: 'true', false: 'false', unknown: 'not judged'}[truthOf(k)];
        cells.push(`${told}${state[k] & RIGHT ? ', motion right' : ''}`);
      }
      for (const text of cells) row.insertCell().textContent = text;
      return row;
    });
    at('list').tBodies[0].replaceChildren(...rows);
    const more = closing.length - rows.length;
    at('list-more').textContent = !closing.length ? 'No pair reaches this threshold.'
      : more ? `${plural(more, 'further closure')} of lower score: raise the threshold, or click the matrix.` : '';
  };
  const drawThreshold = () => {
    at('threshold').value = Math.round(1000 * (bend(chosen.threshold) - lowest) / (highest - lowest));
    at('threshold-value').textContent = number(chosen.threshold);
    at('threshold-count').textContent = plural(closing.length, 'loop closure');
  };
  const setThreshold = value => {
    chosen.threshold = value === content.threshold ? value : Number(number(value));
    judge();
    draw(drawThreshold, drawMap, drawTimeLine, drawHistogram, drawMatrix, drawCurve, drawList);
  };

  // --- a pair in three dimensions ---------------------------------------------------------------
  const solid = (() => {
    const canvas = at('pair');
    const gl = canvas.getContext('webgl', {antialias: true, preserveDrawingBuffer: true});
    if (!gl) {
      fail('This browser has no WebGL, so pairs are not shown in three dimensions.');
      return null;
    }
    const program = (vertex, fragment) => {
      const made = gl.createProgram();
      for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, source);
        gl.compileShader(shader);
        gl.attachShader(made, shader);
      }
      gl.linkProgram(made);
      return made;
    };
    const surface = program(
      `attribute vec3 place; attribute vec3 normal; uniform mat4 view; uniform mat4 motion;
       varying vec3 up;
       void main() { up = mat3(motion) * normal; gl_Position = view * motion * vec4(place, 1.0); }`,
      `precision mediump float; varying vec3 up; uniform vec3 colour;
       void main() {
         vec3 n = normalize(up);
         float light = 0.28 + 0.95 * max(0.0, dot(n, normalize(vec3(-0.6, 0.55, 0.6))));
         gl_FragColor = vec4(min(colour * light, 1.0), 1.0);
       }`);
    // A line is two triangles, as wide on the screen wherever it is.
    const stroke = program(
      `attribute vec3 place; attribute vec3 other; attribute float side; uniform mat4 view;
       uniform vec2 size; uniform float wide;
       void main() {
         vec4 a = view * vec4(place, 1.0), b = view * vec4(other, 1.0);
         vec2 along = (b.xy / b.w - a.xy / a.w) * size;
         float far = length(along);
         along = far > 0.0001 ? along / far : vec2(1.0, 0.0);
         vec2 across = vec2(-along.y, along.x);
         a.xy += across * side * wide / size * a.w;
         gl_Position = a;
       }`,
      `precision mediump float; uniform vec3 colour; void main() { gl_FragColor = vec4(colour, 1.0); }`);
    const dot = program(
      `attribute vec3 place; uniform mat4 view; uniform float wide;
       void main() { gl_Position = view * vec4(place, 1.0); gl_PointSize = wide; }`,
      `precision mediump float; uniform vec3 colour;
       void main() {
         if (length(gl_PointCoord - 0.5) > 0.5) discard;
         gl_FragColor = vec4(colour, 1.0);
       }`);
    const buffer = (data, kind = gl.ARRAY_BUFFER) => {
      const made = gl.createBuffer();
      gl.bindBuffer(kind, made);
      gl.bufferData(kind, data, gl.STATIC_DRAW);
      return made;
    };
    const meshOf = k => {
      const {rows, columns, cell, x, y} = submaps[k], heights = heightsOf(k);
      const places = new Float32Array(3 * rows * columns), normals = new Float32Array(3 * rows * columns);
      for (let j = 0, n = 0; j < rows; j++) {
        for (let i = 0; i < columns; i++, n++) {
          const slope = (a, b) => {
            const value = (heights[b] - heights[a]) / ((b - a === 1 || b - a === columns ? 1 : 2) * cell);
            return Number.isNaN(value) ? 0 : value;
          };
          places.set([x + i * cell, y + j * cell, heights[n] || 0], 3 * n);
          const gx = slope(i ? n - 1 : n, i < columns - 1 ? n + 1 : n) || 0;
          const gy = slope(j ? n - columns : n, j < rows - 1 ? n + columns : n) || 0;
          normals.set([-gx, -gy, 1], 3 * n);
        }
      }
      const faces = [];
      for (let j = 0; j < rows - 1; j++) {
        for (let i = 0; i < columns - 1; i++) {
          const n = j * columns + i, known = m => !Number.isNaN(heights[m]);
          const [a, b, c, d] = [n, n + 1, n + columns, n + columns + 1];
          if (known(b) && known(c)) {
            if (known(a)) faces.push(a, b, c);
            if (known(d)) faces.push(b, d, c);
          }
        }
      }
      return {
        places: buffer(places), normals: buffer(normals),
        faces: buffer(new Uint16Array(faces), gl.ELEMENT_ARRAY_BUFFER), count: faces.length,
      };
    };
    const drop = mesh => [mesh.places, mesh.normals, mesh.faces].forEach(made => gl.deleteBuffer(made));
    const product = (a, b) => {
      const c = new Float32Array(16);
      for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) {
        for (let k = 0; k < 4; k++) c[4 * j + i] += a[4 * k + i] * b[4 * j + k];
      }
      return c;
    };
    let shown = null;
    const camera = {turn: -0.5, tilt: 0.75, far: 20, middle: [0, 0, 0]};
    const viewOf = () => {
      const {turn, tilt, far, middle} = camera;
      const c = Math.cos(turn), s = Math.sin(turn), ct = Math.cos(tilt), st = Math.sin(tilt);
      const eye = [middle[0] + far * ct * s, middle[1] - far * ct * c, middle[2] + far * st];
      const right = [c, s, 0], up = [-s * st, c * st, ct], back = [ct * s, -ct * c, st];
      const into = v => -(v[0] * eye[0] + v[1] * eye[1] + v[2] * eye[2]);
      const look = new Float32Array([
        right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
        into(right), into(up), into(back), 1]);
      const focal = 1.9, near = far / 50, end = far * 6, ratio = canvas.width / canvas.height;
      const wide = ratio < 1 ? focal : focal / ratio, tall = ratio < 1 ? focal * ratio : focal;
      const lens = new Float32Array([wide, 0, 0, 0, 0, tall, 0, 0,
        0, 0, (end + near) / (near - end), -1, 0, 0, 2 * end * near / (near - end), 0]);
      return product(lens, look);
    };
    const use = (made, name, data, size) => {
      const where = gl.getAttribLocation(made, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, size, gl.FLOAT, false, 0, 0);
    };
    const drawSolid = () => {
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      if (!shown) return;
      gl.enable(gl.DEPTH_TEST);
      const view = viewOf(), lift = at('lift').value / 100, {motion, z} = shown;
      at('lift-value').textContent = lift ? `${lift.toFixed(2)} m` : 'none: as found';
      const c = Math.cos(motion[2]), s = Math.sin(motion[2]);
      const stays = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
      const moves = new Float32Array([c, s, 0, 0, -s, c, 0, 0, 0, 0, 1, 0, motion[0], motion[1], z + lift, 1]);
      gl.useProgram(surface);
      gl.uniformMatrix4fv(gl.getUniformLocation(surface, 'view'), false, view);
      let faces = 0;
      for (const [mesh, matrix, colour, wanted] of [
        [shown.query, moves, [0.2, 0.53, 0.87], at('show-query').checked],
        [shown.database, stays, [0.93, 0.52, 0.13], at('show-database').checked]]) {
        if (!wanted || !mesh.count) continue;
        use(surface, 'place', mesh.places, 3);
        use(surface, 'normal', mesh.normals, 3);
        gl.uniformMatrix4fv(gl.getUniformLocation(surface, 'motion'), false, matrix);
        gl.uniform3fv(gl.getUniformLocation(surface, 'colour'), colour);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.faces);
        gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
        faces += mesh.count / 3;
      }
      let ends = 0;
      if (at('show-lines').checked && shown.line) {
        const places = [], others = [], sides = [], dots = [];
        for (let k = 0; k < shown.line.length; k += 4) {
          const [qx, qy, dx, dy] = shown.line.subarray(k, k + 4);
          const raise = 0.03; // above the surface, so that it does not hide them
          const a = [motion[0] + c * qx - s * qy, motion[1] + s * qx + c * qy,
            (heightAt(shown.ids[0], qx, qy) || 0) + z + lift + raise];
          const b = [dx, dy, (heightAt(shown.ids[1], dx, dy) || 0) + raise];
          places.push(...a, ...a, ...b, ...a, ...b, ...b);
          others.push(...b, ...b, ...a, ...b, ...a, ...a);
          sides.push(1, -1, 1, 1, 1, -1); // across turns about with the other end
          dots.push(...a, ...b);
        }
        const made = [places, others, sides, dots].map(values => buffer(new Float32Array(values)));
        gl.useProgram(stroke);
        gl.uniformMatrix4fv(gl.getUniformLocation(stroke, 'view'), false, view);
        gl.uniform2f(gl.getUniformLocation(stroke, 'size'), canvas.width, canvas.height);
        gl.uniform1f(gl.getUniformLocation(stroke, 'wide'), 2 * ratio);
        gl.uniform3f(gl.getUniformLocation(stroke, 'colour'), 0.05, 0.62, 0.42);
        use(stroke, 'place', made[0], 3);
        use(stroke, 'other', made[1], 3);
        use(stroke, 'side', made[2], 1);
        gl.drawArrays(gl.TRIANGLES, 0, sides.length);
        gl.disableVertexAttribArray(gl.getAttribLocation(stroke, 'side'));
        gl.disableVertexAttribArray(gl.getAttribLocation(stroke, 'other'));
        gl.useProgram(dot);
        gl.uniformMatrix4fv(gl.getUniformLocation(dot, 'view'), false, view);
        gl.uniform1f(gl.getUniformLocation(dot, 'wide'), 7 * ratio);
        gl.uniform3f(gl.getUniformLocation(dot, 'colour'), 0.02, 0.5, 0.33);
        use(dot, 'place', made[3], 3);
        ends = dots.length / 3;
        gl.drawArrays(gl.POINTS, 0, ends);
        made.forEach(data => gl.deleteBuffer(data));
      }
      canvas.dataset.faces = faces;
      canvas.dataset.keypoints = ends;
      canvas.dataset.far = camera.far.toFixed(3);
      canvas.dataset.turn = camera.turn.toFixed(3);
    };
    const show = k => {
      if (shown) [shown.query, shown.database].forEach(drop);
      shown = null;
      if (k >= 0 && finite(k)) {
        // Between the submaps' centres, because a short float has seven digits of a coordinate.
        const ids = [query[k], database[k]], [p, q] = ids.map(id => submaps[id].centre);
        const turn = Math.cos(yaws[k]), across = Math.sin(yaws[k]);
        const motion = [xs[k] + turn * p[0] - across * p[1] - q[0],
          ys[k] + across * p[0] + turn * p[1] - q[1], yaws[k]];
        let z = zs[k] + p[2] - q[2];
        if (!Number.isFinite(z)) { // unknown: the median difference of the heights
          const gaps = [], {rows, columns, cell, x, y} = submaps[ids[0]], heights = heightsOf(ids[0]);
          const c = Math.cos(motion[2]), s = Math.sin(motion[2]);
          for (let n = 0; n < rows * columns; n += 7) {
            const u = x + cell * (n % columns), v = y + cell * Math.floor(n / columns);
            const gap = heightAt(ids[1], motion[0] + c * u - s * v, motion[1] + s * u + c * v) - heights[n];
            if (!Number.isNaN(gap)) gaps.push(gap);
          }
          z = gaps.sort((a, b) => a - b)[gaps.length >> 1] || 0;
        }
        shown = {ids, motion, z, query: meshOf(ids[0]), database: meshOf(ids[1]), line: lines.get(keyOf(...ids))};
        const {x, y, cell, columns, rows} = submaps[ids[1]];
        const heights = heightsOf(ids[1]).filter(value => !Number.isNaN(value));
        const mean = heights.reduce((sum, value) => sum + value, 0) / (heights.length || 1);
        const c = Math.cos(motion[2]), s = Math.sin(motion[2]), other = submaps[ids[0]];
        const u = other.x + other.cell * other.columns / 2, v = other.y + other.cell * other.rows / 2;
        camera.middle = [(x + cell * columns / 2 + motion[0] + c * u - s * v) / 2,
          (y + cell * rows / 2 + motion[1] + s * u + c * v) / 2, mean + 0.4];
        camera.far = 1.15 * cell * Math.max(columns, rows);
        camera.turn = -0.5;
        camera.tilt = 0.75;
      }
      canvas.dataset.pair = k >= 0 ? `${submaps[query[k]].id} ${submaps[database[k]].id}` : '';
      draw(drawSolid);
    };
    const held = new Map();
    const nearer = times => {
      camera.far = Math.max(1, Math.min(500, camera.far * times));
      draw(drawSolid);
    };
    const turned = (dx, dy) => {
      camera.turn -= dx;
      camera.tilt = Math.max(0.05, Math.min(1.55, camera.tilt + dy));
      draw(drawSolid);
    };
    canvas.addEventListener('pointerdown', event => {
      held.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener('pointermove', event => {
      const last = held.get(event.pointerId);
      if (!last) return;
      const now = [event.clientX, event.clientY];
      if (held.size === 2) {
        const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, where]) => where);
        const gap = where => Math.hypot(where[0] - other[0], where[1] - other[1]);
        nearer(gap(last) / Math.max(gap(now), 1));
      } else {
        turned((now[0] - last[0]) / 150, (now[1] - last[1]) / 150);
      }
      held.set(event.pointerId, now);
    });
    for (const kind of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(kind, event => held.delete(event.pointerId));
    }
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      nearer(Math.exp(Math.max(-100, Math.min(100, event.deltaY)) / 400));
    }, {passive: false});
    canvas.addEventListener('keydown', event => {
      const turn = {ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]}[event.key];
      const zoom = {'+': 0.85, '-': 1.18}[event.key];
      if (turn) turned(...turn);
      if (zoom) nearer(zoom);
      if (turn || zoom) event.preventDefault();
    });
    for (const id of ['lift', 'show-query', 'show-database', 'show-lines']) {
      at(id).addEventListener('input', () => draw(drawSolid));
    }
    return {show, draw: drawSolid};
  })();

  const choose = (k, look = true) => {
    chosen.pair = k;
    const title = at('pair-title'), text = at('pair-text');
    if (k < 0) {
      title.textContent = 'Pair';
      text.textContent = 'No pair is chosen: click one in the list, the map, the time line or the matrix.';
    } else {
      title.textContent = `Query ${submaps[query[k]].id} on database ${submaps[database[k]].id}`;
      const told = content.curve && state[k] & (TRUE | FALSE)
        ? ` By the true poses the pair is ${truthOf(k)}, and its motion ${state[k] & RIGHT ? 'right' : 'wrong'}.` : '';
      const dropped = state[k] & DROPPED ? ' The pose graph refused it as wrong.' : '';
      const moved = finite(k)
        ? `${plural(inliers[k], 'inlier')}, ${area[k].toFixed(1)} m² of common ground; `
          + `offset ${xs[k].toFixed(2)} m, ${ys[k].toFixed(2)} m, turn ${(yaws[k] * 180 / Math.PI).toFixed(1)}°.`
          + (lines.has(keyOf(query[k], database[k])) ? '' : ' Its keypoints are not in this page.')
        : 'No motion was found, so there is nothing to show.';
      const reason = reasons.get(keyOf(query[k], database[k]));
      const said = reason && reason.startsWith('score') ? '' : `Score ${number(score[k])}. `;
      text.textContent = `${said}${reason ? `${reason[0].toUpperCase()}${reason.slice(1)}. ` : ''}${moved}${told}${dropped}`
        + ' Drag turns the view, the wheel or two fingers zoom.';
    }
    if (solid) solid.show(k);
    if (!whole) return;
    draw(drawMap, drawTimeLine, drawMatrix, drawList);
    const box = at('pair').getBoundingClientRect();
    if (look && k >= 0 && (box.top > window.innerHeight - 120 || box.bottom < 120)) {
      at('pair-section').scrollIntoView({behavior: 'smooth', block: 'start'});
    }
  };

  // --- what a person does -----------------------------------------------------------------------
  if (whole) {
    const corrected = content.poses.after !== null;
    let moving = 0;
    const press = () => {
      at('before').setAttribute('aria-pressed', chosen.shift < 0.5);
      at('after').setAttribute('aria-pressed', chosen.shift >= 0.5);
    };
    const shiftTo = target => {
      const mine = ++moving, from = chosen.shift, began = performance.now();
      const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
      const step = now => {
        if (mine !== moving) return;
        const share = still ? 1 : Math.min(1, (now - began) / 900);
        chosen.shift = from + (target - from) * share * share * (3 - 2 * share);
        draw(drawMap);
        if (share < 1) requestAnimationFrame(step);
        else press();
      };
      requestAnimationFrame(step);
    };
    at('before').addEventListener('click', () => shiftTo(0));
    at('after').addEventListener('click', () => shiftTo(1));
    at('time').max = submaps.length;
    const setTime = time => {
      chosen.time = Math.max(1, Math.min(submaps.length, time));
      at('time').value = chosen.time;
      at('time-value').textContent = `${chosen.time} of ${plural(submaps.length, 'submap')}`;
      draw(drawMap, drawTimeLine);
    };
    let playing = 0;
    const stop = () => {
      clearInterval(playing);
      playing = 0;
      at('play').textContent = 'Play';
    };
    at('play').addEventListener('click', () => {
      if (playing) { stop(); return; }
      if (chosen.time === submaps.length) setTime(1);
      at('play').textContent = 'Pause';
      playing = setInterval(() => {
        setTime(chosen.time + 1);
        if (chosen.time === submaps.length) stop();
      }, Math.max(60, Math.min(350, 15000 / submaps.length)));
    });
    at('time').addEventListener('input', () => { stop(); setTime(Number(at('time').value)); });
    at('time-line').addEventListener('click', event => {
      stop();
      const [x] = place(at('time-line'), event), wide = at('time-line').clientWidth - 16;
      setTime(1 + Math.round((submaps.length - 1) * (x - 8) / wide));
    });
    at('threshold').addEventListener('input', () =>
      setThreshold(unbend(lowest + (highest - lowest) * at('threshold').value / 1000)));
    at('threshold-reset').addEventListener('click', () => setThreshold(content.threshold));
    const slide = event => {
      const [x] = place(at('histogram'), event), wide = at('histogram').clientWidth - axis.left - axis.right;
      const share = Math.max(0, Math.min(1, (x - axis.left) / wide));
      setThreshold(unbend(lowest + (highest - lowest) * share));
    };
    at('histogram').addEventListener('pointerdown', event => {
      at('histogram').setPointerCapture(event.pointerId);
      slide(event);
    });
    at('histogram').addEventListener('pointermove', event => { if (event.buttons) slide(event); });
    if (curve) at('curve').addEventListener('click', event => {
      const canvas = at('curve'), [x, y] = place(canvas, event);
      const [X, Y] = curveAxes(canvas.clientWidth, canvas.clientHeight);
      const off = point => Math.hypot(X(point[0]) - x, Y(point[1]) - y);
      const nearest = curve.reduce((best, point) => off(point) < off(best) ? point : best);
      setThreshold(nearest[2]);
    });
    at('matrix').addEventListener('click', event => {
      const [x, y] = place(at('matrix'), event), {left, top, side} = map.matrix, n = submaps.length;
      const column = Math.floor(n * (x - left) / side), row = n - 1 - Math.floor(n * (y - top) / side);
      if (column < 0 || row < 0 || column >= n || row >= n || column === row) return;
      let best = rowOf.get(keyOf(column, row)), gap = 1;
      if (n > side / 4) { // cells are too small to be hit: take a closure nearby
        for (const k of closing) {
          const off = Math.hypot(Math.max(query[k], database[k]) - column, Math.min(query[k], database[k]) - row);
          if (off * side / n < 6 && (best === undefined || off < gap)) { best = k; gap = off; }
        }
      }
      if (best !== undefined) choose(best);
    });
    at('map').addEventListener('click', event => {
      const [x, y] = place(at('map'), event);
      let best = -1, least = 14;
      for (const [x1, y1, x2, y2, k] of map.closures) {
        const long = (x2 - x1) ** 2 + (y2 - y1) ** 2 || 1;
        const share = Math.max(0, Math.min(1, ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / long));
        const off = Math.hypot(x1 + share * (x2 - x1) - x, y1 + share * (y2 - y1) - y);
        if (off < least) { best = k; least = off; }
      }
      if (best >= 0) choose(best);
    });
    const fromRow = event => {
      const row = event.target.closest('tbody tr');
      if (row && (event.type === 'click' || event.key === 'Enter')) choose(Number(row.dataset.row));
    };
    at('list').addEventListener('click', fromRow);
    at('list').addEventListener('keydown', fromRow);

    const swatch = (kind, text) => `<span class="swatch ${kind}"></span>${text}`;
    const {truth, known} = content.poses;
    const words = content.curve
      ? `${swatch('true', 'true pair,')} ${swatch('false', 'false pair,')} ${swatch('unknown', 'not judged')}. ` : '';
    at('map-legend').innerHTML = (known
      ? `The solid line is the track${corrected ? ', before the correction dashed in grey' : ''}`
        + `${truth ? ', and the true one dotted in green' : ''}. `
      : 'The submaps have no poses, so they stand in rows. ')
      + 'Straight lines and arcs are loop closures: click one to see the pair. ' + words
      + (corrected ? `The corrected poses are those of the closures at the threshold ${number(content.threshold)}.` : '');
    at('histogram-legend').innerHTML = words
      + `Drag the line, or click: the map, the matrix,${curve ? ' the curve' : ''} and the list follow. A pair that was `
      + 'refused for another reason than its score stays refused.';
    at('matrix-legend').innerHTML = (content.curve
      ? 'Below the diagonal, coloured cells reach the threshold, in blue where they are not judged; above it are the true pairs. '
      : 'Coloured cells reach the threshold. ')
      + `Darker grey is a higher score. ${content.skipped ? `${plural(content.skipped, 'pair')} were not compared. ` : ''}`
      + 'Click a cell to see the pair.';
    press();
    setTime(submaps.length);
  }

  const drawAll = () => {
    readColours();
    if (whole) draw(drawThreshold, drawMap, drawTimeLine, drawHistogram, drawMatrix, drawCurve, drawList);
    if (solid) draw(solid.draw);
  };
  readColours();
  judge();
  drawAll();
  choose(closing.length ? closing[0] : count && finite(0) && !whole ? 0 : -1, false);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', drawAll);
  new ResizeObserver(drawAll).observe(document.body);
  requestAnimationFrame(() => requestAnimationFrame(() => { document.body.dataset.ready = 'true'; }));
})().catch(error => {
  const told = document.getElementById('failure');
  told.textContent = `This page could not be drawn: ${error.message}`;
  told.hidden = false;
  throw error;
});
