/* Linked panels over one time axis: position, error, missing torque and command in the report. */
/* Data comes as numbers in 16 bits (differences, deflated, base64), see explorer.py. Without this script the still */
/* pictures remain. */
"use strict";
/* Fills an empty element with the panels of what explorer.py told. */
async function explore(root, told) {
  if (typeof DecompressionStream === "undefined") return;

  /* ---- data ---- */

  async function unpacked(text) {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint16Array(await new Response(stream).arrayBuffer());
  }

  /* 65535 stands for a reading that is left out; the others are differences modulo 65535. */
  async function series(packed, count) {
    const raw = await unpacked(packed.data);
    const values = new Float64Array(count);
    let level = 0;
    for (let i = 0; i < count; i++) {
      if (raw[i] === 65535) { values[i] = NaN; continue; }
      level = (level + raw[i]) % 65535;
      values[i] = packed.low + level * packed.step;
    }
    return values;
  }

  const loaded = new Map();
  async function stretch(index) {
    if (!loaded.has(index)) {
      const one = told.stretches[index];
      const channels = {};
      for (const [name, packed] of Object.entries(one.channels)) channels[name] = await series(packed, one.count);
      loaded.set(index, channels);
    }
    return loaded.get(index);
  }

  /* ---- state ---- */

  const unit = told.time_unit || "s";
  let current = 0, data = await stretch(0), span = [0, 1], cursor = null, drag = null;
  const hidden = new Set(); /* series that the reader switched off */
  const shownWithout = new Set(); /* effects whose removal is overlaid */
  let overlay = null; /* a free run from outside: {says, lines: one channel a panel} */
  const whole = () => [data.time[0], data.time[data.time.length - 1]];
  span = whole();

  /* ---- page ---- */

  const make = (tag, kind, text) => {
    const made = document.createElement(tag);
    if (kind) made.className = kind;
    if (text !== undefined) made.textContent = text;
    return made;
  };
  const bar = make("div", "tools");
  const panels = make("div", "panels");
  const readout = make("p", "readout");
  readout.setAttribute("aria-live", "polite");
  root.append(bar, panels, readout);
  root.hidden = false;

  function button(text, act, pressed) {
    const made = make("button", "", text);
    made.type = "button";
    if (pressed !== undefined) made.setAttribute("aria-pressed", String(pressed));
    made.addEventListener("click", () => act(made));
    return made;
  }
  const toggled = (made, set, key, inverted) => {
    set.has(key) ? set.delete(key) : set.add(key);
    made.setAttribute("aria-pressed", String(set.has(key) !== inverted));
    draw();
  };

  function tools() {
    bar.replaceChildren();
    const group = label => {
      const made = make("span", "group");
      made.setAttribute("role", "group");
      made.setAttribute("aria-label", label);
      made.append(make("span", "of", label));
      bar.append(made);
      return made;
    };
    if (told.stretches.length > 1) {
      const chooser = make("select");
      chooser.setAttribute("aria-label", "recording");
      told.stretches.forEach((s, i) => chooser.append(new Option(s.name, i, false, i === current)));
      chooser.addEventListener("change", async () => {
        current = Number(chooser.value);
        data = await stretch(current);
        span = whole();
        tools();
        draw();
      });
      group("recording").append(chooser);
    }
    const lines = told.lines.length && group("show");
    for (const line of told.lines) {
      const made = button(line.label, b => toggled(b, hidden, line.key, true), !hidden.has(line.key));
      made.classList.add("line", line.key);
      lines.append(made);
    }
    if (told.without.length) {
      const effects = group("without");
      for (const effect of told.without) {
        effects.append(button(effect.label, b => toggled(b, shownWithout, effect.key, false),
          shownWithout.has(effect.key)));
      }
    }
    const places = told.stretches[current].places;
    if (places.length) {
      const jumps = group("go to");
      for (const place of places) jumps.append(button(place.label, () => zoom(place.start, place.end)));
    }
    const view = group("view");
    view.append(button("whole", () => zoom(...whole())), button("+", () => scaled(0.5)), button("−", () => scaled(2)));
  }

  const canvases = told.panels.map(panel => {
    const made = make("canvas");
    made.tabIndex = 0;
    made.setAttribute("role", "img");
    made.setAttribute("aria-label", `${panel.title}. Arrow keys move, plus and minus zoom, 0 shows all.`);
    panels.append(made);
    return made;
  });

  /* ---- view ---- */

  function zoom(low, high) {
    const [first, last] = whole();
    const least = 8 * (last - first) / data.time.length;
    let width = Math.min(Math.max(high - low, least), last - first);
    const begin = Math.min(Math.max(low, first), last - width);
    span = [begin, begin + width];
    draw();
  }
  function scaled(factor, about) {
    const at = about === undefined ? 0.5 * (span[0] + span[1]) : about;
    zoom(at - (at - span[0]) * factor, at + (span[1] - at) * factor);
  }

  /* ---- drawing ---- */

  const LEFT = 64, RIGHT = 10, TOP = 20, BOTTOM = 20;
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  function indexAt(time) {
    let low = 0, high = data.time.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (data.time[middle] < time) low = middle + 1; else high = middle;
    }
    return low;
  }
  function ticks(low, high, count) {
    const raw = (high - low) / count, size = 10 ** Math.floor(Math.log10(raw));
    const step = size * [1, 2, 5, 10].find(f => f * size >= raw);
    const out = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(k * step);
    return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  }
  function drawn(panel) {
    const lines = panel.lines.filter(l => !hidden.has(l.line) && data[l.channel]);
    const more = (panel.without || []).filter(w => shownWithout.has(w.effect) && data[w.channel]);
    const own = overlay && current === 0 && panel.overlay && overlay[panel.overlay]
      ? [{channel: panel.overlay, says: overlay.says, colour: "ink"}] : [];
    return [...lines, ...more.map((w, i) => ({...w, colour: "ink", dashed: true})), ...own];
  }
  /* Smallest and largest value of each column of pixels, so that no peak is lost. */
  function trace(ink, values, x, y, from, to, width) {
    ink.beginPath();
    let pen = false;
    if (to - from < 3 * width) {
      for (let i = from; i <= to; i++) {
        if (Number.isNaN(values[i])) { pen = false; continue; }
        pen ? ink.lineTo(x(data.time[i]), y(values[i])) : ink.moveTo(x(data.time[i]), y(values[i]));
        pen = true;
      }
    } else {
      let i = from;
      while (i <= to) {
        const column = Math.round(x(data.time[i]));
        let low = Infinity, high = -Infinity;
        for (; i <= to && Math.round(x(data.time[i])) === column; i++) {
          if (values[i] < low) low = values[i];
          if (values[i] > high) high = values[i];
        }
        if (low > high) { pen = false; continue; }
        pen ? ink.lineTo(column, y(low)) : ink.moveTo(column, y(low));
        ink.lineTo(column, y(high));
        pen = true;
      }
    }
    ink.stroke();
  }
  function limits(lines, from, to) {
    let low = Infinity, high = -Infinity;
    for (const line of lines) {
      const values = data[line.channel];
      for (let i = from; i <= to; i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
    }
    if (low > high) return [-1, 1];
    const room = 0.06 * (high - low) || Math.abs(high) * 0.1 || 1;
    return [low - room, high + room];
  }
  function draw() {
    const from = Math.max(indexAt(span[0]) - 1, 0), to = Math.min(indexAt(span[1]) + 1, data.time.length - 1);
    const sans = colour("sans"), bands = told.stretches[current].bands;
    canvases.forEach((canvas, n) => {
      const panel = told.panels[n], width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) return;
      const ratio = window.devicePixelRatio || 1, ink = canvas.getContext("2d");
      canvas.width = width * ratio;
      canvas.height = height * ratio;
      ink.scale(ratio, ratio);
      const lines = drawn(panel), [low, high] = limits(lines, from, to);
      const x = t => LEFT + (t - span[0]) / (span[1] - span[0]) * (width - LEFT - RIGHT);
      const y = v => TOP + (high - v) / (high - low) * (height - TOP - BOTTOM);
      canvas.scale = {x, back: px => span[0] + (px - LEFT) / (width - LEFT - RIGHT) * (span[1] - span[0])};
      ink.font = `11px ${sans}`;
      ink.save();
      ink.beginPath();
      ink.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
      ink.clip();
      for (const band of bands) {
        ink.fillStyle = colour(`band-${band.kind}`);
        const begin = x(band.start), end = x(band.end);
        ink.fillRect(begin, TOP, Math.max(end - begin, 1), height - TOP - BOTTOM);
      }
      ink.restore();
      const [across, digits] = ticks(span[0], span[1], Math.max(2, width / 110));
      const [up, decimals] = ticks(low, high, Math.max(4, height / 45));
      ink.strokeStyle = colour("grid");
      ink.fillStyle = colour("muted");
      ink.lineWidth = 1;
      ink.textAlign = "right";
      ink.textBaseline = "middle";
      for (const v of up) {
        ink.beginPath(); ink.moveTo(LEFT, y(v)); ink.lineTo(width - RIGHT, y(v)); ink.stroke();
        const text = Math.abs(v) >= 1e5 || decimals > 5 ? v.toPrecision(3) : v.toFixed(decimals);
        ink.fillText(text.replace("-", "−"), LEFT - 6, y(v));
      }
      ink.textAlign = "center";
      ink.textBaseline = "top";
      for (const t of across) {
        ink.beginPath(); ink.moveTo(x(t), TOP); ink.lineTo(x(t), height - BOTTOM); ink.stroke();
        const label = t.toFixed(digits) + (n === canvases.length - 1 ? ` ${unit}` : "");
        /* The last one ends where the panel does. */
        ink.fillText(label, Math.min(x(t), width - 0.5 * ink.measureText(label).width - 1), height - BOTTOM + 5);
      }
      ink.save();
      ink.beginPath();
      ink.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
      ink.clip();
      for (const line of lines) {
        ink.strokeStyle = colour(line.colour);
        ink.lineWidth = line.wide ? 3 : 1.2;
        ink.setLineDash(line.dashed ? [5, 3] : []);
        trace(ink, data[line.channel], x, y, from, to, width - LEFT - RIGHT);
      }
      ink.setLineDash([]);
      if (!lines.some(line => data[line.channel].subarray(from, to).some(v => !Number.isNaN(v)))) {
        ink.fillStyle = colour("muted");
        ink.textAlign = "center";
        ink.textBaseline = "middle";
        ink.fillText("nothing known here", 0.5 * (LEFT + width - RIGHT), 0.5 * (TOP + height - BOTTOM));
      }
      if (drag && drag.to !== undefined) {
        ink.fillStyle = colour("select");
        const [a, b] = [x(drag.from), x(drag.to)].sort((p, q) => p - q);
        ink.fillRect(a, TOP, b - a, height - TOP - BOTTOM);
      } else if (cursor !== null) {
        ink.strokeStyle = colour("muted");
        ink.beginPath(); ink.moveTo(x(cursor), TOP); ink.lineTo(x(cursor), height - BOTTOM); ink.stroke();
      }
      ink.restore();
      ink.textAlign = "left";
      ink.textBaseline = "alphabetic";
      ink.fillStyle = colour("ink");
      ink.fillText(panel.title, LEFT, 13);
    });
    root.dataset.span = span.map(t => t.toFixed(6)).join(" ");
    say();
  }
  function say() {
    if (cursor === null) {
      readout.textContent = "Drag over a stretch to zoom; double-click shows all. " +
        told.legend;
      return;
    }
    const i = indexAt(cursor), parts = [`${data.time[i].toFixed(3)} ${unit}`];
    for (const panel of told.panels) {
      const known = drawn(panel).filter(line => !Number.isNaN(data[line.channel][i]));
      /* A lone line that says what its panel does needs no second name. */
      const said = known.map(line => (known.length > 1 ? `${line.says} ` : "") + data[line.channel][i].toPrecision(4));
      parts.push(`${panel.title}: ${said.join(", ") || "not read"}`);
    }
    const band = told.stretches[current].bands.filter(b => b.start <= cursor && cursor <= b.end);
    readout.textContent = [...parts, ...band.map(b => b.says)].join(" · ").replaceAll("-", "−");
  }

  /* ---- hand and keyboard ---- */

  for (const canvas of canvases) {
    const at = event => canvas.scale.back(event.clientX - canvas.getBoundingClientRect().left);
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      drag = {from: at(event)};
    });
    canvas.addEventListener("pointermove", event => {
      cursor = at(event);
      if (drag) drag.to = cursor;
      draw();
    });
    canvas.addEventListener("pointerup", () => {
      const made = drag;
      drag = null;
      if (made && made.to !== undefined && Math.abs(canvas.scale.x(made.to) - canvas.scale.x(made.from)) > 4) {
        zoom(Math.min(made.from, made.to), Math.max(made.from, made.to));
      } else draw();
    });
    canvas.addEventListener("pointercancel", () => { drag = null; draw(); });
    canvas.addEventListener("pointerleave", () => { if (!drag) { cursor = null; draw(); } });
    canvas.addEventListener("dblclick", () => zoom(...whole()));
    canvas.addEventListener("wheel", event => {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      scaled(event.deltaY + event.deltaX > 0 ? 1.25 : 0.8, at(event));
    }, {passive: false});
    canvas.addEventListener("keydown", event => {
      const width = span[1] - span[0];
      const acts = {
        ArrowLeft: () => zoom(span[0] - 0.2 * width, span[1] - 0.2 * width),
        ArrowRight: () => zoom(span[0] + 0.2 * width, span[1] + 0.2 * width),
        "+": () => scaled(0.5), "=": () => scaled(0.5), "-": () => scaled(2), "0": () => zoom(...whole()),
      };
      if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
    });
  }
  /* A page around this one may lay a free run of its own over the first recording: {says, run, error} as packed. */
  root.addEventListener("overlay", async event => {
    const given = event.detail, count = told.stretches[0].count, first = await stretch(0);
    if (given) for (const name of ["run", "error"]) first[name] = await series(given[name], count);
    overlay = given;
    draw();
  });
  for (const link of document.querySelectorAll("[data-from]")) {
    link.addEventListener("click", event => {
      event.preventDefault();
      zoom(Number(link.dataset.from), Number(link.dataset.to));
      root.scrollIntoView({behavior: "smooth", block: "start"});
    });
  }
  new ResizeObserver(draw).observe(panels);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  tools();
  draw();
  root.dataset.ready = "yes";
}
{
  const source = document.getElementById("explorer-data");
  if (source) explore(document.getElementById("explorer"), JSON.parse(source.textContent));
}
