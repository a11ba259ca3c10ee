// The numbers of one decision, and the table of the decisions that deserve a look.
function fillFacts() {
  const facts = byId("facts");
  facts.replaceChildren();
  const record = data.told[chosenIndex];
  if (!record) return;
  const advice = (data.reasons[record.reason] || {}).advice;
  const evidence = record.evidence || {};
  if (data.kind === "report") facts.append(make("h3", "", `Decision ${chosenIndex}`));
  facts.append(verdictBadge(record.verdict), make("p", "words", `${record.words}.`), make("p", "code", `${record.reason}: ${record.detail || "no detail"}`));
  if (record.verdict !== "accepted" && advice) facts.append(make("p", "advice", `What to do: ${advice}.`));
  const rows = [["Probability of a right pose", share(record.probability)]];
  const told = (name, key, digits = 4) => { if (key in evidence) rows.push([name, share(evidence[key], digits)]); };
  told("Oriented overlap", "oriented_overlap_ratio", 3);
  if (evidence.num_points_source_in_target || evidence.num_points_target_in_source) {
    told("Denied surface, both scans", "denied_ratio");
    told("Denied, of the source", "denied_ratio_source_in_target");
    told("Denied, of the target", "denied_ratio_target_in_source");
    told("Denied, by width of clusters", "wide_denied_ratio");
    told("Resistance to a shift", "weakest_constraint", 3);
  }
  told("Blocked, target's lines", "blocked_ratio_source_in_target");
  told("Blocked, source's lines", "blocked_ratio_target_in_source");
  told("Seen from both sides", "opposed_ratio");
  told("Filled free space, target's", "free_blocked_ratio_source_in_target");
  told("Filled free space, source's", "free_blocked_ratio_target_in_source");
  if (typeof record.translation_error_m === "number") rows.push(["Error of the pose", `${record.translation_error_m.toFixed(2)} m, ${record.rotation_error_deg.toFixed(2)}°`]);
  if (record.origin) rows.push(["Pose came from", record.origin]);
  if (record.method) rows.push(["Method", record.method]);
  if (record.time_ms && record.time_ms.total) rows.push(["Time", `${record.time_ms.total.toFixed(0)} ms`]);
  for (const side of ["source", "target"]) {
    if (typeof record[side] === "string") rows.push([side === "source" ? "Source" : "Target", record[side]]);
    else if (record[`${side}_stamp_ns`]) rows.push([side === "source" ? "Source stamp" : "Target stamp", seconds(record[`${side}_stamp_ns`])]);
  }
  facts.append(twoColumns(rows));
  if (record.best_candidate) {
    const details = make("details");
    details.append(make("summary", "", "Judged pose, source in the target's frame"));
    details.append(make("pre", "", record.best_candidate.map((row) => row.map((v) => v.toFixed(4).padStart(10)).join("")).join("\n")));
    facts.append(details);
  }
}

// Nanoseconds are beyond the whole numbers that a browser keeps; they are shown to the millisecond.
function seconds(ns) { return `${(ns / 1e9).toFixed(3)} s`; }

function fillWorst() {
  const place = byId("worst");
  place.replaceChildren();
  if (!data.worst.length) {
    byId("worst-hint").textContent = "There is none.";
    return;
  }
  const withError = data.worst.some(({ line }) => typeof data.told[line].translation_error_m === "number");
  byId("worst-hint").textContent = `${data.worst.length} of ${whole(totalDecisions())} decisions, the most telling ones of each kind.`;
  const heads = ["Decision", "Verdict", "Reason in words", "Probability", "Overlap", "Denied", ...(withError ? ["Error"] : []), "3D"];
  const table = make("table", "worst");
  const head = make("tr");
  heads.forEach((text, k) => head.append(make("th", k > 2 && text !== "3D" ? "num" : "", text, { scope: "col" })));
  const thead = make("thead");
  thead.append(head);
  const body = make("tbody");
  data.worst.forEach((entry, k) => {
    if (!k || data.worst[k - 1].why !== entry.why) {
      const kind = make("tr", "kind");
      kind.append(make("th", "", entry.why, { colspan: heads.length, scope: "colgroup" }));
      body.append(kind);
    }
    body.append(worstRow(entry, withError));
  });
  table.append(thead, body);
  place.append(table);
}

function worstRow({ line }, withError) {
  const record = data.told[line];
  const row = make("tr", "", "", { "data-line": line });
  const cell = (classes, text, label = "") => { const td = make("td", classes, text, label ? { "data-label": label } : {}); row.append(td); return td; };
  cell("", `# ${line}`);
  cell("", "").append(verdictBadge(record.verdict));
  const words = cell("", "");
  words.append(make("div", "words", `${record.words}.`), make("div", "detail", record.detail || ""));
  const evidence = record.evidence || {};
  const seen = evidence.num_points_source_in_target || evidence.num_points_target_in_source;
  cell("num", share(record.probability), "probability");
  cell("num", share(evidence.oriented_overlap_ratio), "overlap");
  cell("num", seen ? share(evidence.denied_ratio, 4) : "–", "denied");
  if (withError) cell("num", typeof record.translation_error_m === "number" ? `${record.translation_error_m.toFixed(2)} m` : "–", "error");
  const show = cell("", "");
  if (packed.has(line)) {
    const button = make("button", "", "Show", { type: "button", "aria-label": `Show decision ${line} in 3D` });
    button.addEventListener("click", () => { choose(line); byId("pairs").scrollIntoView(); byId("view3d").focus({ preventScroll: true }); });
    show.append(button);
  } else show.append(make("span", "why", "not kept"));
  return row;
}

function markRow() {
  for (const row of document.querySelectorAll("table.worst tbody tr")) row.classList.toggle("chosen", Number(row.dataset.line) === chosenIndex);
}
