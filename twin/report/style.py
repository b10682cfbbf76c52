"""The looks of figures and report: a few colours, two typefaces that are everywhere, one column."""

INK, MUTED, GRID = "#1f2328", "#6b7280", "#e6e8eb"
BEFORE, AFTER, RECORDED = "#c2570c", "#0b7285", "#aab2bd"
MISFIT, HELD = "#fbeadb", "#f1f5f7"

#: The page's style sheet.
CSS = f"""
:root {{ color-scheme: light dark; --paper: #fff; --grid: {GRID}; --band-misfit: {MISFIT}; --band-held: {HELD};
  --band-fault: #f6dfe4; --select: #0b728533; --ink: {INK}; --muted: {MUTED}; --rule: #d9dde2; --before: {BEFORE};
  --after: {AFTER}; --recorded: {RECORDED}; --misfit: {MISFIT}; --tint: #eef6f7;
  --serif: Charter, "Bitstream Charter", "Iowan Old Style", "Palatino Linotype", Palatino, P052, Georgia, serif;
  --sans: "Helvetica Neue", "Segoe UI", "Nimbus Sans", "Liberation Sans", Arial, sans-serif; }}
* {{ box-sizing: border-box; }}
html {{ font-size: 17px; }}
body {{ margin: 0; background: var(--paper); color: var(--ink); font-family: var(--serif); line-height: 1.55;
  font-variant-numeric: lining-nums; text-rendering: optimizeLegibility; }}
main {{ max-width: 54rem; margin: 0 auto; padding: 4.5rem 1.6rem 6rem; }}
p {{ margin: 0 0 0.9em; max-width: 40rem; hyphens: manual; }}
h1 {{ font-size: 2.15rem; line-height: 1.18; font-weight: 600; letter-spacing: -0.012em; margin: 0.5rem 0 1rem;
  max-width: 46rem; text-wrap: balance; }}
h2 {{ font-size: 1.28rem; line-height: 1.3; font-weight: 600; margin: 0 0 1.1rem; letter-spacing: -0.005em; }}
h3 {{ font-size: 1.02rem; font-weight: 600; margin: 1.6rem 0 0.5rem; }}
section {{ border-top: 1px solid var(--rule); margin-top: 3.2rem; padding-top: 1.3rem; }}
code {{ font-family: ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; font-size: 0.8em; }}
.kicker {{ font-family: var(--sans); font-size: 0.78rem; color: var(--muted); margin: 0; letter-spacing: 0.01em; }}
.verdict {{ display: inline-block; margin-left: 0.7em; padding: 0.1em 0.65em 0.14em; border-radius: 1em;
  background: var(--tint); color: var(--after); font-weight: 600; }}
.verdict:is(.unexplained, .partly_explained, .inconclusive, .stopped) {{ background: var(--misfit); color: #9a4408; }}
.source {{ color: var(--muted); font-size: 0.92rem; margin-bottom: 2rem; }}
.lead {{ font-size: 1.12rem; line-height: 1.5; max-width: 43rem; }}
.remark {{ border-left: 3px solid var(--before); padding-left: 0.9rem; }}
.note, p.note {{ color: var(--muted); font-size: 0.86rem; line-height: 1.45; }}
td .note {{ display: block; max-width: 22rem; font-size: 0.78rem; }}
.merits {{ display: flex; flex-wrap: wrap; gap: 0 2rem;
  border-top: 2px solid var(--ink); margin: 0 0 2.2rem; }}
.merit {{ flex: 1 1 9rem; padding: 0.9rem 0 0.2rem; }}
.merit p {{ margin: 0; }}
.merit .value {{ font-size: 1.5rem; line-height: 1.25; letter-spacing: -0.01em; white-space: nowrap; }}
.merit .was {{ color: var(--before); font-size: 1.02rem; }}
.merit .to {{ color: var(--muted); font-size: 1rem; padding: 0 0.3em; }}
.merit .label {{ font-family: var(--sans); font-size: 0.72rem; line-height: 1.35; color: var(--muted);
  padding-top: 0.2rem; max-width: 12rem; }}
.finding {{ background: var(--tint); border-radius: 8px; padding: 1.1rem 1.5rem 0.6rem; margin: 0 0 1.4rem; }}
.finding h3 {{ margin: 0 0 0.4rem; font-size: 1.12rem; }}
.finding .where {{ font-family: var(--sans); font-weight: 400; font-size: 0.76rem; color: var(--muted);
  margin-left: 0.9em; }}
.finding .scroll {{ margin-bottom: 0.7rem; }}
.finding tbody tr:last-child td {{ border-bottom: 0; }}
.equation {{ display: flex; flex-wrap: wrap; align-items: baseline; gap: 0.15rem 1.2rem; margin: 0.45rem 0; }}
.equation.large {{ margin: 0.9rem 0 1rem; font-size: 1.12rem; }}
.equation .about {{ font-family: var(--sans); font-size: 0.74rem; color: var(--muted); flex: 0 0 13rem; }}
.equation > span:last-child {{ flex: 1 1 24rem; }}
.term {{ display: inline-block; margin: 0.1rem 0.14em; white-space: nowrap; }}
.term.new {{ color: var(--after); background: #d9ecee; border-radius: 4px; padding: 0.12em 0.3em; }}
.finding .term.new {{ background: none; padding: 0; }}
svg.math {{ fill: currentColor; overflow: visible; }}
.equation, .large {{ overflow-x: auto; overflow-y: hidden; }}
.equation, .scroll {{ position: relative; }}
td.symbol {{ white-space: nowrap; }}
figure {{ margin: 0 0 1.5rem; }}
figcaption {{ font-family: var(--sans); font-size: 0.76rem; line-height: 1.45; color: var(--muted); max-width: 43rem;
  padding-top: 0.35rem; }}
svg.figure {{ display: block; width: 100%; height: auto; }}
svg.figure text {{ font-family: var(--sans); }}
.chain .station rect {{ fill: #fff; stroke: var(--muted); stroke-width: 1; }}
.chain .station text {{ font-size: 13px; fill: var(--ink); }}
.chain .station.found rect {{ fill: var(--after); stroke: var(--after); }}
.chain .station.found text {{ fill: #fff; font-weight: 600; }}
.chain .arrow {{ stroke: var(--muted); fill: none; }}
.chain .what {{ font-size: 13px; fill: var(--after); font-weight: 600; }}
.chain .end {{ font-size: 12px; fill: var(--muted); }}
.key {{ display: inline-block; width: 1.3em; height: 0.2em; vertical-align: 0.25em; margin-right: 0.35em;
  border-radius: 1px; }}
.key.before {{ background: var(--before); }} .key.after {{ background: var(--after); }}
.key.recorded {{ background: var(--recorded); height: 0.34em; }}
.key.misfit {{ background: var(--misfit); height: 0.8em; vertical-align: -0.05em; }}
.scroll {{ overflow-x: auto; margin: 0 0 1.2rem; }}
table {{ border-collapse: collapse; font-size: 0.86rem; line-height: 1.4; min-width: 24rem; }}
caption {{ text-align: left; font-family: var(--sans); font-size: 0.76rem; color: var(--muted);
  padding-bottom: 0.4rem; }}
th {{ font-family: var(--sans); font-weight: 500; font-size: 0.72rem; color: var(--muted); text-align: left;
  border-bottom: 1px solid var(--ink); padding: 0.25rem 1.6rem 0.3rem 0; vertical-align: bottom; }}
td {{ border-bottom: 1px solid var(--rule); padding: 0.36rem 1.6rem 0.36rem 0; vertical-align: baseline; }}
th:last-child, td:last-child {{ padding-right: 0; }}
td.number, th.number {{ text-align: right; font-variant-numeric: lining-nums tabular-nums; white-space: nowrap; }}
.ranking {{ list-style: none; margin: 0 0 1.2rem; padding: 0; max-width: 46rem; font-size: 0.9rem; }}
.ranking li {{ display: grid; grid-template-columns: 18.5rem 1fr 5rem; gap: 0.8rem; align-items: center;
  padding: 0.14rem 0; }}
.ranking .bar {{ background: #f1f3f5; height: 0.62rem; border-radius: 2px; overflow: hidden; }}
.ranking .bar span {{ display: block; height: 100%; background: var(--recorded); }}
.ranking .chosen .bar span {{ background: var(--after); }}
.ranking .chosen .name {{ font-weight: 600; }}
.ranking .p {{ text-align: right; color: var(--muted); font-size: 0.84rem; white-space: nowrap; }}
.notes {{ padding-left: 1.1rem; max-width: 42rem; font-size: 0.92rem; }}
.notes li {{ margin: 0 0 0.35rem; }}
.explorer {{ margin: 0 0 1.5rem; }}
@media screen {{ .explorer[data-ready] ~ figure.still {{ display: none; }} }}
.explorer .tools {{ display: flex; flex-wrap: wrap; gap: 0.45rem 1.1rem; margin: 0 0 0.6rem; font-family: var(--sans);
  font-size: 0.74rem; }}
.explorer .group {{ display: inline-flex; flex-wrap: wrap; align-items: center; gap: 0.3rem; }}
.explorer .of {{ color: var(--muted); }}
.explorer button, .explorer select {{ font: inherit; color: var(--ink); background: var(--paper);
  border: 1px solid var(--rule); border-radius: 4px; padding: 0.22em 0.6em; cursor: pointer; min-height: 2em; }}
.explorer button:hover {{ border-color: var(--muted); }}
.explorer button[aria-pressed=true] {{ background: var(--tint); border-color: var(--after); }}
.explorer button.line::before {{ content: ""; display: inline-block; width: 1.1em; height: 0.22em;
  vertical-align: 0.28em; margin-right: 0.4em; background: var(--after); }}
.explorer button.line.before::before {{ background: var(--before); }}
.explorer button.line.recorded::before {{ background: var(--recorded); }}
.explorer button[aria-pressed=false] {{ color: var(--muted); }}
.explorer canvas {{ display: block; width: 100%; height: 8.2rem; touch-action: pan-y; cursor: crosshair; }}
.explorer canvas:first-child {{ height: 13rem; }}
.explorer :focus-visible, a:focus-visible {{ outline: 2px solid var(--after); outline-offset: 2px; }}
.explorer .readout {{ font-family: var(--sans); font-size: 0.74rem; color: var(--muted); max-width: none;
  min-height: 2.9em; margin: 0.3rem 0 0; font-variant-numeric: tabular-nums; }}
.spoken {{ position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); white-space: nowrap; }}
.digest {{ overflow-wrap: anywhere; }}
.commands {{ font-size: 0.86rem; overflow-x: auto; background: var(--tint); padding: 0.7rem 1rem; border-radius: 6px; }}
@media (prefers-color-scheme: dark) {{
  :root {{ --paper: #14171a; --ink: #e6e8eb; --muted: #9aa4b0; --rule: #333a42; --grid: #2a3036; --before: #f0883e;
    --after: #3fb6cc; --recorded: #66707c; --misfit: #47301b; --tint: #1a2a2e; --band-misfit: #3a2a1a;
    --band-held: #1e252b; --band-fault: #3b2229; --select: #3fb6cc33; }}
  svg.figure:not(.chain) {{ filter: invert(0.9) hue-rotate(180deg); }}
  .chain .station rect {{ fill: var(--paper); }} .chain .station.found text {{ fill: var(--paper); }}
  .term.new {{ background: #17343a; }} .ranking .bar {{ background: #262c32; }}
  .verdict:is(.unexplained, .partly_explained, .inconclusive, .stopped) {{ color: #f0a36b; }} }}
@media (max-width: 40rem) {{ html {{ font-size: 15.5px; }} main {{ padding-top: 2rem; }} h1 {{ font-size: 1.7rem; }}
  .ranking li {{ grid-template-columns: 9rem 1fr 4.4rem; }} .equation .about {{ flex-basis: 100%; }} }}
@media print {{ .explorer {{ display: none; }} html {{ font-size: 10.5pt; }} main {{ max-width: none; padding: 0;
  }} section {{ margin-top: 1.8rem; }}
  figure, table, .finding, .merits, .equation, li {{ break-inside: avoid; }} h2, h3 {{ break-after: avoid; }}
  * {{ print-color-adjust: exact; -webkit-print-color-adjust: exact; }} @page {{ margin: 18mm 16mm; }} }}
"""
