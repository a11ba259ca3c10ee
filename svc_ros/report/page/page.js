// Choosing a pair, the switch between light and dark, and the first drawing.
const filter = byId("filter"), pair = byId("pair");

function listed() {
  return data.scenes.map((scene) => scene.index).filter((index) => filter.value === "all" || !filter.value || data.told[index].verdict === filter.value);
}

function fillPairs() {
  const indices = listed();
  pair.replaceChildren(...indices.map((index) => {
    const record = data.told[index];
    const sure = record.probability === null || record.probability === undefined ? "" : `, probability ${share(record.probability, 2)}`;
    return make("option", "", `# ${index}  ${record.verdict}: ${record.reason}${sure}`, { value: index });
  }));
  pair.disabled = !indices.length;
  if (!indices.includes(chosenIndex) && indices.length) choose(indices[0]);
  else showChoice();
}

function fillFilter() {
  const num = (verdict) => data.scenes.filter((scene) => data.told[scene.index].verdict === verdict).length;
  const options = [["all", `all ${data.scenes.length} kept`]];
  for (const verdict of VERDICTS) if (num(verdict)) options.push([verdict, `${num(verdict)} ${verdict}`]);
  filter.replaceChildren(...options.map(([value, text]) => make("option", "", text, { value })));
  filter.addEventListener("change", fillPairs);
}

function showChoice() {
  const indices = listed(), place = indices.indexOf(chosenIndex);
  pair.value = String(chosenIndex);
  byId("previous").disabled = place <= 0;
  byId("next").disabled = place < 0 || place >= indices.length - 1;
  fillFacts();
  markRow();
}

function choose(index) {
  if (!packed.has(index)) return false;
  chosenIndex = index;
  if (!listed().includes(index)) { filter.value = "all"; fillPairs(); }
  shown = sceneOf(index);
  showChoice();
  byId("announced").textContent = `Decision ${index}, ${data.told[index].verdict}: ${data.told[index].words}.`;
  drawScene();
  if (data.kind === "report") moveRings();
  return true;
}

function step(by) {
  const indices = listed(), place = indices.indexOf(chosenIndex) + by;
  if (place >= 0 && place < indices.length) choose(indices[place]);
}

function chooseFromPlot(line) {
  if (choose(line)) { byId("pairs").scrollIntoView(); return; }
  say(`Decision ${line} was not kept for 3D; those with a ring were.`);
}

function drawAll() {
  if (data.kind === "report") { drawTimeline(); drawEvidence(); drawMap(); drawTimes(); }
  drawScene();
}

function fillTiles() {
  const total = totalDecisions();
  const tile = (name, number, more, colour = "") => {
    const item = make("li", "tile");
    const label = make("span", "name");
    label.append(name);
    item.append(label, make("span", `number ${colour}`, number), make("span", "more", more));
    byId("tiles").append(item);
  };
  tile("decisions", whole(total), data.times.num_decisions ? `median ${data.times.total_median_ms.toFixed(0)} ms each` : "");
  for (const verdict of VERDICTS) {
    if (verdict === "dropped" && !data.counts.dropped) continue;
    tile(verdictBadge(verdict), whole(data.counts[verdict]), total ? `${((100 * data.counts[verdict]) / total).toFixed(1)} %` : "");
  }
  const false_accepts = told("reference.num_false_accepted"), compared = told("reference.num_accepted_compared");
  if (typeof false_accepts === "number") tile("false accepts", whole(false_accepts), `of ${whole(compared)} compared with the reference`, false_accepts ? "rejected" : "");
  const ape = told("reference.ape.translation_m.rmse");
  if (typeof ape === "number") tile("trajectory error", `${ape.toFixed(ape < 1 ? 3 : 2)} m`, "APE, root mean square");
  const factor = told("real_time_factor");
  if (typeof factor === "number") tile("speed", `${factor.toFixed(1)} ×`, "of real time");
}

const told = (name) => (data.summary.find(([key]) => key === name) || [])[1];

function fillSummary() {
  const plain = (value) => (value === null ? "–" : typeof value === "number" && !Number.isInteger(value) ? String(Number(value.toPrecision(4))) : value);
  const rows = data.summary.map(([name, value]) => [name.replaceAll("_", " "), plain(value)]);
  const nested = /^(latency_ms|reference|versions|run|verdicts|reasons)\./;
  const first = rows.filter((_, k) => !nested.test(data.summary[k][0]));
  const rest = rows.filter((_, k) => nested.test(data.summary[k][0]));
  const place = byId("summary");
  if (!rows.length) { place.append(make("p", "hint", "There is no summary.")); return; }
  place.append(twoColumns(first));
  if (!rest.length) return;
  const details = make("details");
  details.append(make("summary", "", `All ${rows.length} numbers of summary.json`), twoColumns(rest));
  place.append(details);
}

function setUpTheme() {
  const set = (theme) => { document.documentElement.dataset.theme = theme; drawAll(); };
  for (const input of document.querySelectorAll("#theme input")) input.addEventListener("change", () => set(input.value));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (document.documentElement.dataset.theme === "auto") drawAll(); });
}

function setUpKeys() {
  byId("previous").addEventListener("click", () => step(-1));
  byId("next").addEventListener("click", () => step(1));
  pair.addEventListener("change", () => choose(Number(pair.value)));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ["SELECT", "INPUT"].includes(document.activeElement.tagName)) return;
    if (event.key === "n") step(1);
    if (event.key === "p") step(-1);
  });
}

function start() {
  document.body.classList.add(data.kind);
  byId("title").textContent = data.title;
  const about = [told("mode"), told("topic"), told("method") && `method ${told("method")}`, told("preset") && `preset ${[told("preset"), told("chosen.preset")].filter(Boolean).join(": ")}`];
  byId("subtitle").textContent = about.filter(Boolean).join("  ·  ");
  byId("version").textContent = data.version;
  if (data.kind === "view") byId("pairs-title").textContent = "The pair in 3D";
  byId("foot").textContent = `Written by svc_ros ${data.version}. The page needs no network; scenes are thinned copies, coordinates rounded to 16 bits. In a plot, drag to zoom and double-click to see all.`;
  byId("notes").hidden = !data.notes.length;
  byId("notes").append(...data.notes.map((text) => make("li", "", text)));
  setUpTheme();
  setUpView();
  setUpKeys();
  if (data.kind === "report") {
    fillTiles();
    fillFilter();
    fillWorst();
    fillSummary();
  }
  byId("pairs").hidden = !data.scenes.length;
  if (data.scenes.length) { shown = sceneOf(chosenIndex); fillPairs(); }
  drawAll();
}

window.svcReport = {
  data,
  indices: () => data.scenes.map((scene) => scene.index),
  scene: sceneOf,
  chosen: () => chosenIndex,
  choose,
};
start();
window.svcReport.ready = true;
