// The page of a calibration: two plots and three tables from the numbers in the page.
const data = JSON.parse(document.getElementById("report-data").textContent);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const share = (value) => (value === null ? "-" : `${Number((100 * value).toPrecision(3))} %`);

function table(id, rows, head) {
  const made = document.createElement("table");
  made.className = "plain";
  for (const [k, row] of (head ? [head, ...rows] : rows).entries()) {
    const line = made.insertRow();
    for (const cell of row) {
      const place = document.createElement(head && k === 0 ? "th" : "td");
      place.textContent = cell;
      line.append(place);
    }
  }
  document.getElementById(id).append(made);
}

function line(name, y, colour, more) {
  return { type: "scatter", mode: "lines", name, x: data.curve.min_probability, y, line: { color: colour, width: 2, ...more } };
}

// A border as a line through both plots, with its name on top.
function border(p, name, colour, side) {
  return {
    shape: { type: "line", x0: p, x1: p, yref: "paper", y0: 0, y1: 1, line: { color: colour, width: 1.5, dash: "dot" } },
    note: { x: p, yref: "paper", y: 1, yanchor: "bottom", xanchor: side, showarrow: false, text: `${name} ${p}`, font: { color: colour } },
  };
}

function drawCurve() {
  const c = data.curve, other = data.chosen || data.surest;
  const marks = [border(data.present.min_probability, "present", css("soft"), "left"),
    border(other.min_probability, data.chosen ? "chosen" : "best", css("accent"), "right")];
  const top = Math.min(1.05, 1.3 * Math.max(data.max_wrong_rate, ...c.bound, ...c.failed_rate));
  Plotly.newPlot("curve", [
    line(`bound, ${share(data.confidence)} confidence`, c.bound, css("rejected"), { shape: "hv", dash: "dash" }),
    line("pairs with a wrong acceptance", c.failed_rate, css("rejected"), { shape: "hv" }),
    { ...line("right poses accepted", c.right_accepted_share, css("accepted"), { shape: "hv" }), yaxis: "y2" },
  ], {
    ...look(), margin: { l: 70, r: 20, t: 30, b: 90 }, legend: { orientation: "h", y: -0.2 }, hovermode: "x unified",
    xaxis: { title: { text: "demanded probability" }, range: [0.495, 1.005], anchor: "y2" },
    yaxis: { domain: [0.55, 1], range: [0, top], tickformat: ".1~%", title: { text: "wrong" } },
    yaxis2: { domain: [0, 0.45], range: [0, 1.05], tickformat: ".0%", title: { text: "right" } },
    shapes: [...marks.map((m) => m.shape), { type: "line", xref: "paper", x0: 0, x1: 1, y0: data.max_wrong_rate, y1: data.max_wrong_rate,
      line: { color: css("undecided"), width: 1.5 } }],
    annotations: [...marks.map((m) => m.note), { xref: "paper", x: 0.02, y: data.max_wrong_rate, yanchor: "bottom", showarrow: false,
      text: `asked for: ${share(data.max_wrong_rate)}`, font: { color: css("undecided") } }],
  }, { displaylogo: false, responsive: true });
}

function drawReliability() {
  const rows = data.reliability.filter((row) => row.num);
  Plotly.newPlot("reliability", [
    { type: "scatter", mode: "lines", name: "as true as it says", x: [0, 1], y: [0, 1], line: { color: css("soft"), dash: "dot" }, hoverinfo: "skip" },
    { type: "scatter", mode: "markers+lines", name: "poses", x: rows.map((r) => r.mean_probability), y: rows.map((r) => r.right_share),
      text: rows.map((r) => `${r.num} poses`), hovertemplate: "probability %{x:.3f}<br>right %{y:.3f}<br>%{text}<extra></extra>",
      marker: { color: css("accent"), size: rows.map((r) => 6 + 3 * Math.log10(r.num)) }, line: { color: css("accent"), width: 1 } },
  ], {
    ...look(), margin: { l: 60, r: 20, t: 10, b: 45 }, showlegend: false,
    xaxis: { title: { text: "probability" }, range: [-0.03, 1.03] }, yaxis: { title: { text: "share that is right" }, range: [-0.03, 1.05] },
  }, { displaylogo: false, responsive: true });
}

const look = () => ({ paper_bgcolor: css("card"), plot_bgcolor: css("card"), font: { color: css("ink"), size: 13 } });
const digits = (value) => (value === null ? "-" : value.toFixed(2));

document.getElementById("version").textContent = data.version;
document.getElementById("title").textContent = data.title;
document.getElementById("statement").textContent = data.statement;
table("borders", data.borders.slice(1), data.borders[0]);
table("counts", data.counts);
const wrong = data.wrong_accepted.map((w) => [w.dataset, w.pair, w.kind, w.probability.toFixed(4), digits(w.rotation_error_deg), digits(w.translation_error_m)]);
document.getElementById("wrong-hint").textContent = wrong.length ?
  "Look at these first: a wrong reference looks just like a wrong acceptance." : "None.";
if (wrong.length) table("wrong", wrong, ["data set", "pair", "made by", "probability", "off by [deg]", "off by [m]"]);
drawCurve();
drawReliability();
