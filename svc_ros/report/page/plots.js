// The flat plots: verdicts over time, evidence, times by stage, the way from above.
const FLOOR = 0.0003; // smallest denied share that the logarithmic axis shows
const TICKS = [FLOOR, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1];
const height = (denied) => Math.log10(Math.max(denied, FLOOR)); // the axis itself is linear: shapes are true only there

function decisionRows() {
  const d = data.decisions;
  return d.line.map((line, k) => ({
    line, time: d.time_s[k], verdict: d.verdict[k], reason: d.reason[k], probability: d.probability[k],
    overlap: d.overlap[k], denied: d.denied[k], kept: packed.has(line),
  }));
}

function hoverText(row) {
  const time = row.time === null ? "" : ` at ${row.time.toFixed(1)} s`;
  const numbers = row.overlap === null ? "" : `<br>overlap ${share(row.overlap)}${row.denied === null ? "" : `, denied ${share(row.denied, 4)}`}`;
  const sure = row.probability === null ? "" : `<br>probability ${share(row.probability)}`;
  return `<b>decision ${row.line}</b>${time}<br>${row.verdict}: ${row.reason}${sure}${numbers}${row.kept ? "<br>click: look at it in 3D" : ""}`;
}

// One trace a verdict; rejected and undecided ones on top, and a ring around what can be looked at.
function verdictTraces(rows, x, y) {
  const traces = [];
  for (const verdict of ["dropped", "accepted", "undecided", "rejected"]) {
    const some = rows.filter((row) => row.verdict === verdict);
    if (!some.length) continue;
    const colour = css(verdict);
    traces.push({
      type: "scatter", mode: "markers", name: verdict, x: some.map(x), y: some.map(y),
      customdata: some.map((row) => row.line), text: some.map(hoverText), hovertemplate: "%{text}<extra></extra>",
      marker: { symbol: SYMBOLS[verdict], size: verdict === "accepted" ? 7 : 9, color: colour, opacity: verdict === "accepted" ? 0.75 : 0.95,
        line: { width: verdict === "dropped" ? 1.5 : 0, color: colour } },
    });
  }
  const kept = data.scenes.length < totalDecisions() ? rows.filter((row) => row.kept) : [];
  traces.push({
    type: "scatter", mode: "markers", name: "in 3D", hoverinfo: "skip", x: kept.map(x), y: kept.map(y),
    marker: { symbol: "circle-open", size: 14, color: css("soft"), line: { width: 1 }, opacity: 0.7 },
  });
  return traces;
}

// A thick ring around the chosen decision: a shape, which moves without drawing the plot anew.
const places = {}; // plot -> line -> [x, y]
function ring(id) {
  const place = places[id].get(chosenIndex) || [0, 1];
  return {
    type: "circle", visible: places[id].has(chosenIndex), xsizemode: "pixel", ysizemode: "pixel", xanchor: place[0], yanchor: place[1],
    x0: -10, x1: 10, y0: -10, y1: 10, line: { color: css("accent"), width: 3 },
  };
}

function moveRings() {
  for (const id of Object.keys(places)) Plotly.relayout(byId(id), { "shapes[0]": ring(id) });
}

const placesOf = (rows, x, y) => new Map(rows.map((row) => [row.line, [x(row), y(row)]]));

function draw(id, traces, plotLayout) {
  const div = byId(id);
  const first = !div.data;
  Plotly.react(div, traces, plotLayout, PLOT_CONFIG);
  if (first) div.on("plotly_click", (event) => {
    const line = event.points.map((point) => point.customdata).find((value) => value !== undefined);
    if (line !== undefined) chooseFromPlot(line);
  });
}

// All decisions of every part of the run, as the shares of their verdicts; it stands above the marks.
function stripTraces() {
  const { start, width, counts } = data.strip;
  const sums = start.map((_, k) => VERDICTS.reduce((sum, verdict) => sum + counts[verdict][k], 0) || 1);
  const base = start.map(() => 1.07);
  return VERDICTS.map((verdict) => {
    const parts = counts[verdict].map((count, k) => (0.1 * count) / sums[k]);
    const trace = {
      type: "bar", x: start.map((x) => x + width / 2), y: parts, base: [...base], width, marker: { color: css(verdict), line: { width: 0 } },
      customdata: start.map(() => undefined), hovertemplate: `%{text} ${verdict}<extra></extra>`, text: counts[verdict].map(String), textposition: "none",
    };
    parts.forEach((part, k) => { base[k] += part; });
    return trace;
  });
}

function drawTimeline() {
  const rows = decisionRows();
  const timed = rows.some((row) => row.time !== null);
  const x = (row) => (timed ? row.time : row.line);
  const unjudged = rows.some((row) => row.probability === null);
  const y = (row) => (row.probability === null ? -0.14 : row.probability);
  const traces = verdictTraces(rows, x, y);
  places.timeline = placesOf(rows, x, y);
  traces.unshift(...stripTraces());
  const ticks = [0, 0.25, 0.5, 0.75, 1];
  draw("timeline", traces, layout({
    xaxis: axis(timed ? "time since the first scan [s]" : "decision", { showgrid: false }),
    yaxis: axis("probability", {
      range: [unjudged ? -0.22 : -0.06, 1.2], tickvals: unjudged ? [-0.14, ...ticks] : ticks,
      ticktext: (unjudged ? ["not judged"] : []).concat(ticks.map(String)),
    }),
    shapes: [ring("timeline"), { type: "line", xref: "paper", x0: 0, x1: 1, y0: 0.5, y1: 0.5, line: { color: css("soft"), width: 1, dash: "dot" } }],
    margin: { l: 56, r: 12, t: 4, b: 40 }, barmode: "overlay", bargap: 0,
  }));
  const drawn = rows.length;
  const total = totalDecisions();
  const thinned = drawn < total;
  byId("timeline-note").textContent =
    `${whole(drawn)} of ${whole(total)} decisions drawn${thinned ? ", in all plots alike: those not accepted have the first claim, the others are chosen evenly" : ""}; ` +
    `${data.scenes.length < total ? `${whole(data.scenes.length)} of ${whole(total)} kept for 3D, those with a ring` : "all of them kept for 3D"}. The strip on top counts all of them: the share of each verdict in ${data.strip.start.length} equal parts of the run.`;
  describe("timeline", `Verdicts over time: ${VERDICTS.map((v) => `${data.counts[v]} ${v}`).join(", ")}.`);
}

function drawEvidence() {
  const judged = decisionRows().filter((row) => row.overlap !== null);
  const rows = judged.filter((row) => row.denied !== null);
  const y = (row) => height(row.denied);
  const border = data.border;
  places.evidence = placesOf(rows, (row) => row.overlap, y);
  const traces = [];
  const bottom = height(FLOOR) - 0.1, top = height(1) + 0.1;
  const outer = border ? border.outer.map(height) : [], inner = border ? border.inner.map(height) : [];
  if (border) {
    const area = (line, upper, colour) => traces.push({
      type: "scatter", mode: "lines", hoverinfo: "skip", line: { width: 0 }, fill: "toself", fillcolor: css(colour),
      x: [...border.overlap, ...[...border.overlap].reverse()], y: [...line, ...[...upper].reverse()],
    });
    const flat = (value) => border.overlap.map(() => value);
    area(outer, flat(top), "tint-no");
    area(inner, outer, "tint-maybe");
    area(flat(bottom), inner, "tint-yes");
    traces.push({ type: "scatter", mode: "lines", hoverinfo: "skip", x: [0, border.min_overlap, border.min_overlap, 0], y: [bottom, bottom, top, top], line: { width: 0 }, fill: "toself", fillcolor: css("tint-none") });
    const line = (values, dash) => traces.push({ type: "scatter", mode: "lines", hoverinfo: "skip", x: border.overlap, y: values, line: { color: css("soft"), width: 1.5, dash } });
    line(outer, "solid");
    line(inner, "dash");
  }
  const narrow = byId("evidence").clientWidth < 420; // a phone: there the note below the plot has to do
  const label = (x, y, text, more = {}) => ({ x, y, text, showarrow: false, font: { size: 12, color: css("soft") }, xanchor: "right", ...more });
  draw("evidence", traces.concat(verdictTraces(rows, (row) => row.overlap, y)), layout({
    xaxis: axis("oriented overlap", { range: [0, 1.02] }), shapes: [ring("evidence")],
    yaxis: axis("denied share of the surface in view", { range: [bottom, top], tickvals: TICKS.map(height), ticktext: TICKS.map((value) => (value === FLOOR ? `≤ ${value}` : String(value))) }),
    annotations: border && !narrow ? [
      label(0.99, top - 0.12, "never accepted"), label(0.99, (outer.at(-1) + inner.at(-1)) / 2, "structure and clusters decide"), label(0.99, inner.at(-1) - 0.35, "never rejected for it"),
      label(border.min_overlap / 2, (bottom + top) / 2, "too little overlap", { textangle: -90, xanchor: "center" }),
    ] : [],
    margin: { l: 64, r: 12, t: 8, b: 44 },
  }));
  byId("evidence-hint").textContent = "Surface that the other sensor looked through speaks against a pose, surface seen alike by both scans for it.";
  byId("evidence-note").textContent = `${whole(rows.length)} judged decisions drawn` +
    `${rows.length < judged.length ? `, ${whole(judged.length - rows.length)} not, which tell no denied share` : ""}. ` + (border
    ? "Above the solid line no pose is accepted, even if surfaces face all ways and only small clusters are denied; below the dashed line denied surface never rejects one; in between it depends on structure and on how wide the denied clusters are."
    : "No border is drawn: the method of this run decides by another rule.");
  describe("evidence", `Denied share against oriented overlap of ${rows.length} judged decisions.`);
}

function drawMap() {
  const map = data.map;
  places.map = new Map();
  const line = (points, name, style) => ({ type: "scatter", mode: "lines", name, hoverinfo: "skip", x: points.map((p) => p[0]), y: points.map((p) => p[1]), line: style });
  const traces = [];
  if (map.reference.length) traces.push(line(map.reference, "reference", { color: css("soft"), width: 1.5, dash: "dot" }));
  if (map.way.length) traces.push(line(map.way, "way", { color: css("ring"), width: 5 }));
  if (map.optimized.length) traces.push(line(map.optimized, "optimized", { color: css("accent"), width: 2 }));
  let drawn = 0;
  for (const verdict of ["dropped", "accepted", "undecided", "rejected"]) {
    const links = map.links[verdict];
    if (!links.length) continue;
    drawn += links.length;
    const x = links.flatMap(([, x0, , x1]) => [x0, x1, null]);
    const y = links.flatMap(([, , y0, , y1]) => [y0, y1, null]);
    traces.push({ type: "scatter", mode: "lines", hoverinfo: "skip", x, y, line: { color: css(verdict), width: 2, dash: verdict === "accepted" ? "solid" : "dash" } });
    const rows = new Map(decisionRows().map((row) => [row.line, row]));
    traces.push({
      type: "scatter", mode: "markers", name: verdict, customdata: links.map(([k]) => k), hovertemplate: "%{text}<extra></extra>",
      text: links.map(([k]) => hoverText(rows.get(k))), x: links.map(([, x0, , x1]) => (x0 + x1) / 2), y: links.map(([, , y0, , y1]) => (y0 + y1) / 2),
      marker: { symbol: SYMBOLS[verdict], size: verdict === "accepted" ? 6 : 10, color: css(verdict), line: { width: verdict === "dropped" ? 1.5 : 0, color: css(verdict) } },
    });
    for (const [k, x0, y0, x1, y1] of links) places.map.set(k, [(x0 + x1) / 2, (y0 + y1) / 2]);
  }
  const spanned = [...map.way, ...map.optimized, ...VERDICTS.flatMap((v) => map.links[v].flatMap(([, x0, y0, x1, y1]) => [[x0, y0], [x1, y1]]))];
  const range = (k) => { // of the way and the links; the reference may lead far away
    if (!spanned.length) return {};
    const low = spanned.reduce((a, p) => Math.min(a, p[k]), Infinity), high = spanned.reduce((a, p) => Math.max(a, p[k]), -Infinity);
    const margin = 0.06 * (high - low) + 0.5;
    return { range: [low - margin, high + margin] };
  };
  draw("map", traces, layout({
    shapes: [ring("map")],
    xaxis: axis("x [m]", range(0)), yaxis: axis("y [m]", { scaleanchor: "x", scaleratio: 1, ...range(1) }), dragmode: coarse.matches ? false : "pan",
    margin: { l: 56, r: 12, t: 8, b: 44 },
  }));
  byId("map-hint").textContent = "Links join the two scans of a decision: solid where accepted, dashed where not.";
  const from = { trajectory: "Places are those of trajectory_tum.txt.", reference: "Places are those of the reference.", "accepted pairs": "Places follow from accepted pairs, in the frame of the first of them." }[map.basis];
  byId("map-note").textContent = `${map.way.length ? from : "No scan could be placed."} ${whole(drawn)} links drawn` +
    `${map.num_unplaced ? `, ${whole(map.num_unplaced)} not, for want of a place for one of their scans` : ""}.` +
    `${map.optimized.length ? " Thin: the way after the loops, trajectory_optimized_tum.txt." : ""}` +
    `${map.reference.length ? " Dotted: the reference, moved rigidly onto the way." : ""}`;
  describe("map", `The way from above with ${map.links.accepted.length} accepted and ${map.links.rejected.length} rejected links.`);
}

function drawTimes() {
  const t = data.times;
  const rare = (k) => (t.num[k] < t.num_decisions ? `  (${whole(t.num[k])} of ${whole(t.num_decisions)})` : "");
  const names = t.stages.map((name, k) => name.replaceAll("_", " ") + rare(k)).reverse();
  const bar = (values, name, width, colour, opacity) => ({
    type: "bar", orientation: "h", name, y: names, x: [...values].reverse(), width, marker: { color: colour, opacity },
    hovertemplate: `%{y}: ${name} %{x:.1f} ms<extra></extra>`,
  });
  byId("times").style.height = `${Math.max(180, 70 + 27 * names.length)}px`;
  draw("times", [bar(t.p95_ms, "95th percentile", 0.74, css("accent"), 0.25), bar(t.median_ms, "median", 0.42, css("accent"), 1)], layout({
    barmode: "overlay", xaxis: axis("milliseconds", { rangemode: "tozero" }), yaxis: axis("", { showgrid: false, tickfont: { size: 13, color: css("ink") } }),
    margin: { l: 90, r: 12, t: 4, b: 44 },
  }));
  byId("times-hint").textContent = t.num_decisions
    ? `Full bar: median; pale: 95th percentile, over the decisions that had the stage. In the order of the time spent in all. A whole decision took ${t.total_median_ms.toFixed(1)} ms, 95th percentile ${t.total_p95_ms.toFixed(1)} ms.`
    : "No decision tells how long it took.";
  describe("times", `Median time by stage: ${t.stages.map((name, k) => `${name} ${t.median_ms[k].toFixed(1)} ms`).join(", ")}.`);
}

function describe(id, text) { byId(id).setAttribute("aria-label", text); }
