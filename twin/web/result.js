/* What the report has only while its server runs: files to take along, and parameters on sliders. */
"use strict";
(async () => {
  const told = await (await fetch("/sliders")).json();
  const make = (tag, properties, ...inside) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...inside);
    return made;
  };
  const digits = value => Number(value.toPrecision(4)).toString().replace("-", "−");

  /* ---- files ---- */

  /* Text and what it is; of what is made only when it is asked for, the file that has to be there. */
  const FILES = {
    "improved.fmu": ["FMU", "co-simulation, FMI 2, for hosts with Python"],
    "improved-native.fmu": ["native FMU", "compiled, FMI 2, for hosts without Python"],
    "improved-native-fmi3.fmu": ["native FMU, FMI 3", "compiled, for hosts without Python", "improved.fmu"],
    "controller.toml": ["controller", "its gains, for twin cosim"],
    "controller.fmu": ["controller FMU", "co-simulation, FMI 2", "controller.toml"],
    "improved.toml": ["model", "parameters and covariance, for twin export"],
    "rig.toml": ["rig.toml", "what the columns are"],
    "report.html": ["report", "this page without its server"],
    "next_experiment.csv": ["next experiment", "the input to play and record"],
    "diagnosis.json": ["JSON", "the diagnosis for programs"],
  };
  const said = make("p", {className: "problem", hidden: true});
  said.setAttribute("role", "alert");
  const links = make("nav", {className: "actions"}, make("span", {className: "quiet", textContent: "Download"}));
  links.setAttribute("aria-label", "files to download");
  for (const [name, [text, title, base]] of Object.entries(FILES)) {
    if (!told.files.includes(base || name)) continue;
    const link = make("a", {className: "button", href: `/files/${name}`, download: name, textContent: text, title});
    if (base) link.addEventListener("click", event => { event.preventDefault(); made(link, name, text); });
    links.append(link);
  }
  const header = document.querySelector("main > header");
  header.before(make("p", {className: "kicker"}, make("a", {href: "/", textContent: "← recording and columns"})));
  header.after(make("div", {className: "take"}, links, said));
  /* Some take a while; what hinders them is said. */
  async function made(link, name, text) {
    link.textContent = `${text}: making …`;
    said.hidden = true;
    const answer = await fetch(link.href);
    link.textContent = text;
    if (answer.ok) {
      const address = URL.createObjectURL(await answer.blob());
      make("a", {href: address, download: name}).click();
      URL.revokeObjectURL(address);
    } else {
      said.textContent = (await answer.json()).problem;
      said.hidden = false;
    }
  }

  /* ---- sliders ---- */

  const root = document.getElementById("explorer");
  if (!root || !told.sliders || !told.sliders.length) return;
  const values = {};
  const now = make("p", {className: "now"});
  now.setAttribute("role", "status");
  const percent = free => free.nrmse_percent === null ? "no number" : `${digits(free.nrmse_percent)} %`;
  const simulate = async values => {
    const answer = await fetch("/simulate", {method: "POST", body: JSON.stringify(values)});
    const free = await answer.json();
    if (!answer.ok) throw new Error(free.problem);
    return free;
  };
  let model = "";
  function own() {
    now.textContent = `The free run errs by ${model} of the recorded range. Move a parameter to see it change.`;
    root.dispatchEvent(new CustomEvent("overlay", {detail: null}));
  }
  function slider(one) {
    const shown = value => `${digits(value)}${one.unit === "1" ? "" : ` ${one.unit}`}`;
    const out = make("output", {textContent: shown(one.value)});
    const range = make("input", {type: "range", min: one.low, max: one.high, step: "any", name: one.name});
    range.value = one.value;
    range.addEventListener("input", () => {
      values[one.name] = Number(range.value);
      out.textContent = shown(values[one.name]);
      run();
    });
    range.back = () => { range.value = one.value; out.textContent = shown(one.value); };
    return make("label", {title: one.meaning}, out, one.name.replaceAll("_", " "),
      make("span", {textContent: one.meaning}), range);
  }
  /* One run at a time; what was moved meanwhile is run next. */
  let running = false, waiting = false;
  async function run() {
    waiting = true;
    if (running) return;
    running = true;
    while (waiting) {
      waiting = false;
      try {
        const free = await simulate(values);
        if (!Object.keys(values).length) continue;
        now.replaceChildren(make("span", {className: "key ink"}),
          `With these parameters the free run errs by ${percent(free)}, the model's own by ${model} of the range.`);
        root.dispatchEvent(new CustomEvent("overlay", {detail: {says: "with these parameters", ...free}}));
      } catch (error) {
        now.textContent = error.message;
      }
    }
    running = false;
  }
  const first = told.sliders[0].effect, found = told.sliders.filter(s => s.effect === first);
  const rest = told.sliders.filter(s => s.effect !== first);
  const reset = make("button", {type: "button", textContent: "Back to the model's values"});
  const panel = make("div", {className: "try"}, make("h3", {textContent: "Try other values"}),
    make("div", {className: "rows"}, ...found.map(slider)), make("div", {className: "beneath"}, now, reset));
  if (rest.length) {
    panel.append(make("details", {}, make("summary", {textContent: `${rest.length} more parameters`}),
      make("div", {className: "rows"}, ...rest.map(slider))));
  }
  reset.addEventListener("click", () => {
    for (const name of Object.keys(values)) delete values[name];
    for (const range of panel.querySelectorAll("input")) range.back();
    own();
  });
  /* The sliders stay in sight over all panels. */
  const around = make("div", {className: "trying"});
  root.before(around);
  around.append(panel, root);
  try {
    model = percent(await simulate({}));
    own();
  } catch (error) {
    now.textContent = error.message;
  }
})();
