/* The page of twin serve: a log is dropped, its columns are chosen over a preview, the search is watched. */
"use strict";
{
  const $ = id => document.getElementById(id);
  const LARGEST = 256 * 2 ** 20, EVERY = 700; /* bytes; ms between two looks at the search */
  /* What the selects offer: the unit as the rig file has it, and in words. */
  const UNITS = {
    time: {s: "s", ms: "ms", us: "µs", ns: "ns"},
    input: {"%": "%", "1": "fraction", ticks: "timer ticks", V: "V", A: "A", "N*m": "N m", N: "N"},
    output: {
      rad: "rad", deg: "degrees", rev: "turns", count: "counts", m: "m", mm: "mm", "rad/s": "rad/s", "deg/s": "degrees/s",
      "rev/s": "turns/s", rpm: "rpm", "count/s": "counts/s", "m/s": "m/s", "mm/s": "mm/s",
    },
  };
  let columns = [], sections = {}, remarks = {};

  async function ask(path, body) {
    const options = body === undefined ? {} : {method: "POST", body: body instanceof Blob ? body : JSON.stringify(body)};
    let said;
    try {
      const answer = await fetch(path, options);
      said = await answer.json();
      if (answer.ok) return said;
    } catch {
      said = {problem: "The server does not answer: is twin serve still running?"};
    }
    throw new Error(said.problem);
  }
  function problem(text) {
    $("problem").textContent = sentence(text);
    $("problem").hidden = !text;
    if (text) $("problem").scrollIntoView({block: "nearest"});
  }
  /* With a capital where it begins with a word, which no file name and no key is, and a full stop. */
  const sentence = text => (text || "").replace(/^[a-z]+(?=[ ,])/, word => word[0].toUpperCase() + word.slice(1)) +
    (!text || /[.!?…]$/.test(text) ? "" : ".");
  function make(tag, properties, ...inside) {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...inside);
    return made;
  }
  const items = texts => (texts || []).map(text => make("li", {textContent: sentence(text)}));
  /* The panels anew: a fresh element, so that nothing of the last ones is left. */
  function panels(id, told) {
    const fresh = $(id).cloneNode(false);
    $(id).replaceWith(fresh);
    if (told) explore(fresh, told);
  }
  const ORDER = ["drop", "columns", "search", "result"];
  function step(name) {
    for (const id of ORDER.slice(0, 3)) $(id).hidden = id !== name; /* the result is a page of its own */
    $("lead").hidden = name !== "drop";
    for (const item of document.querySelectorAll(".steps li")) {
      item.toggleAttribute("aria-current", false);
      if (item.dataset.step === name) item.setAttribute("aria-current", "step");
      item.classList.toggle("past", ORDER.indexOf(item.dataset.step) < ORDER.indexOf(name));
    }
    problem("");
  }
  /* Where the user went on, the keyboard and the screen reader go on, too. */
  function go(name) {
    step(name);
    $(name).focus({preventScroll: true});
    window.scrollTo(0, 0);
  }

  /* ---- a log is dropped ---- */

  async function upload(file) {
    if (!file) return;
    problem("");
    if (file.size > LARGEST) {
      problem(`${file.name} is larger than 256 MiB: give it to twin run, or drop a part of it`);
      return;
    }
    $("reading").hidden = false;
    try {
      $("shown").hidden = true;
      set(await ask(`/log?name=${encodeURIComponent(file.name)}`, file));
      go("columns");
    } catch (error) {
      problem(error.message);
    }
    $("reading").hidden = true;
    $("file").value = "";
  }
  $("file").addEventListener("change", () => upload($("file").files[0]));
  const area = document.querySelector(".drop");
  document.addEventListener("dragover", event => { event.preventDefault(); area.classList.add("over"); });
  document.addEventListener("dragleave", event => { if (!event.relatedTarget) area.classList.remove("over"); });
  document.addEventListener("drop", event => {
    event.preventDefault();
    area.classList.remove("over");
    if (!$("drop").hidden) upload(event.dataTransfer.files[0]);
  });
  for (const again of document.querySelectorAll(".again")) again.addEventListener("click", () => go("drop"));

  /* ---- its columns are chosen ---- */

  function set(looked) {
    columns = looked.columns;
    sections = Object.fromEntries(Object.entries(looked.sections).map(([title, table]) => [title, {...table.keys}]));
    for (const title of ["time", "input", "output"]) sections[title] ||= {};
    remarks = Object.fromEntries(Object.entries(looked.sections).map(([title, table]) => [title, table.remarks]));
    $("name").textContent = looked.name;
    fields();
    show(looked);
    step("columns");
  }
  /* One control with its label; `act` gets what the user sets. */
  function field(label, control, value, act, kind) {
    control.value = value;
    control.addEventListener("change", () => { act(control.value); fields(); choose(); });
    return make("label", {className: kind || ""}, label, control);
  }
  function choice(options, value) {
    const made = make("select", {});
    const known = options.some(([key]) => key === value);
    for (const [key, text] of known ? options : [[value, value || "choose"], ...options]) made.append(new Option(text, key));
    return made;
  }
  const number = () => make("input", {type: "number", step: "any", inputMode: "decimal"});
  function group(title, ...controls) {
    const told = Object.entries(remarks[title] || {}).map(([key, remark]) => `${key.replaceAll("_", " ")}: ${remark}`);
    const made = make("fieldset", {}, make("legend", {textContent: title[0].toUpperCase() + title.slice(1)}), ...controls);
    if (told.length) controls[1].after(make("p", {className: "remark-of", textContent: told.join("; ")}));
    return made;
  }
  const names = () => columns.map(name => [name, name]);
  function put(title, key, value) {
    if (value === "" || value === undefined) delete sections[title][key];
    else sections[title][key] = value;
    if (remarks[title]) delete remarks[title][key];
  }
  function time() {
    const own = sections.time, none = [["", "no column: a fixed step"], ...names()];
    const column = field("column", choice(none, own.column || ""), own.column || "", value => {
      sections.time = value ? {column: value, unit: own.unit || "s"} : {sample_time: own.sample_time || 0.001};
      remarks.time = {};
    });
    if (own.column) {
      return group("time", column, field("unit", choice(Object.entries(UNITS.time), own.unit || "s"), own.unit || "s",
        value => put("time", "unit", value)));
    }
    return group("time", column, field("step, s", number(), own.sample_time ?? "", value =>
      put("time", "sample_time", Number(value))));
  }
  function input() {
    const own = sections.input, unit = own.full_scale !== undefined ? "ticks" : own.unit || "";
    const parts = [
      field("column", choice(names(), own.column || ""), own.column || "", value => put("input", "column", value)),
      field("unit", choice(Object.entries(UNITS.input), unit), unit, value => {
        put("input", "unit", value === "ticks" ? "" : value);
        put("input", "full_scale", value === "ticks" ? 255 : "");
      }),
    ];
    if (unit === "ticks") {
      parts.push(field("ticks at full drive", number(), own.full_scale, value =>
        put("input", "full_scale", Number(value)), "wide"));
    }
    const sign = (sections["input.direction"] || {}).column || "";
    parts.push(field("its sign is in", choice([["", "the column itself"], ...names()], sign), sign, value => {
      if (value) sections["input.direction"] = {column: value};
      else delete sections["input.direction"];
    }, "wide"));
    return group("input", ...parts);
  }
  function output() {
    const own = sections.output, unit = own.unit || "";
    const parts = [
      field("column", choice(names(), own.column || ""), own.column || "", value => put("output", "column", value)),
      field("unit", choice(Object.entries(UNITS.output), unit), unit, value => {
        put("output", "unit", value);
        if (!value.startsWith("count")) put("output", "counts_per_revolution", "");
      }),
    ];
    if (unit.startsWith("count")) {
      parts.push(field("counts per revolution, after quadrature and gear; none: the axis is in counts", number(),
        own.counts_per_revolution, value => put("output", "counts_per_revolution", Number(value) || ""), "wide"));
    }
    const place = {link: "the link, behind the gear", motor: "the motor"};
    parts.push(field("the sensor sits on", choice(Object.entries(place), own.location || "link"), own.location || "link",
      value => put("output", "location", value === "motor" ? value : ""), "wide"));
    const turned = make("input", {type: "checkbox", checked: own.scale === -1});
    turned.addEventListener("change", () => { put("output", "scale", turned.checked ? -1 : ""); choose(); });
    parts.push(make("label", {className: "tick"}, turned, "it counts against the input: turn it round"));
    return group("output", ...parts);
  }
  function fields() {
    const focus = [...$("fields").querySelectorAll("select, input")].indexOf(document.activeElement);
    $("fields").replaceChildren(time(), input(), output());
    if (focus >= 0) $("fields").querySelectorAll("select, input")[focus]?.focus();
  }
  $("form").addEventListener("submit", event => event.preventDefault());

  let asked = 0;
  async function choose() {
    const mine = ++asked;
    $("start").disabled = $("shown").hidden = true;
    try {
      const chosen = await ask("/rig", sections);
      if (mine === asked) show(chosen);
    } catch (error) {
      if (mine === asked) show({problem: error.message, text: $("rig").textContent});
    }
  }
  function show(chosen) {
    $("blocked").textContent = sentence(chosen.problem);
    $("blocked").hidden = !chosen.problem;
    $("start").disabled = Boolean(chosen.problem);
    $("says").textContent = sentence(chosen.says);
    if (chosen.unsure) $("unsure").replaceChildren(...items(chosen.unsure));
    $("notes").replaceChildren(...items([...(chosen.notes || []), ...(chosen.faults || [])].slice(0, 12)));
    $("rig").textContent = chosen.text;
    panels("preview", chosen.panels);
  }

  /* ---- the search is watched ---- */

  $("start").addEventListener("click", async () => {
    try {
      await ask("/search", {});
      watch();
    } catch (error) {
      problem(error.message);
    }
  });
  $("stop").addEventListener("click", async () => {
    $("stop").disabled = true;
    try {
      await ask("/stop", {});
    } catch (error) {
      problem(error.message);
    }
  });
  function bar(name, share, text, kind) {
    const inside = make("span", {});
    inside.style.width = `${Math.max(0.4, 100 * Math.min(share, 1))}%`;
    return make("li", {className: kind || ""}, make("span", {className: "name", textContent: name}),
      make("span", {className: "bar"}, inside), make("span", {className: "p", textContent: text}));
  }
  let round = 1;
  function happened(event, models) {
    if (event.kind === "stage") {
      $("stage").textContent = sentence(event.says).replace(/\.$/, "");
      $("bar").value = Math.max($("bar").value, event.share);
      round = (/^round (\d+)/.exec(event.says) || [0, round])[1];
    } else if (event.kind === "rivals") {
      $("round").textContent = `Rivals of round ${round}`;
      $("rivals").replaceChildren(...(event.bars.length
        ? event.bars.map((b, i) => bar(b.title, b.share, `+${b.gain}`, i ? "" : "chosen"))
        : [make("li", {className: "quiet", textContent: "No candidate explains more than it costs."})]));
    } else if (event.kind === "model") {
      const and = [...event.joined.map(t => `+ ${t}`), ...event.left.map(t => `− ${t}`)].join(", ");
      if (models.length && !and) return;
      models.push(event);
      $("models").append(bar(and || "first model", event.share, event.lacks, models.length === 1 ? "first" : "chosen"));
      panels("missing", event.panels);
    }
  }
  async function watch() {
    go("search");
    $("stop").disabled = false;
    $("models").replaceChildren();
    $("rivals").replaceChildren(make("li", {className: "quiet", textContent: "The first model is fitted before any."}));
    $("bar").value = 0;
    panels("missing", null);
    const models = [], begun = Date.now();
    for (let since = 0; ;) {
      let told;
      try {
        told = await ask(`/watch?since=${since}`);
      } catch (error) {
        problem(error.message);
        return;
      }
      since += told.events.length;
      told.events.forEach(event => happened(event, models));
      const seconds = Math.round((Date.now() - begun) / 1000);
      $("clock").textContent = `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
      $("stop").hidden = told.state !== "searching";
      if (told.state === "done") {
        location.assign("/result");
        return;
      }
      if (told.state === "choosing") {
        go("columns");
        problem(told.problem);
        return;
      }
      await new Promise(resolve => setTimeout(resolve, EVERY));
    }
  }

  /* A page that is loaded anew goes on where the work stands. */
  ask("/state").then(told => {
    if (told.looked && told.looked.columns) set(told.looked);
    $("shown").hidden = told.state !== "done";
    if (told.state === "searching" || told.state === "finishing") watch();
  }).catch(error => problem(error.message));
}
