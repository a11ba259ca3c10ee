// Texts, marks and colours that all parts of the page share.
const byId = (id) => document.getElementById(id);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const whole = (n) => n.toLocaleString("en-US");
const share = (x, digits = 3) => (x === null || x === undefined ? "–" : x.toFixed(digits));
const SYMBOLS = { accepted: "circle", rejected: "x", undecided: "diamond", dropped: "line-ns-open" };
const SHAPES = {
  accepted: '<circle cx="5.5" cy="5.5" r="5"/>',
  rejected: '<path d="M1 3 3 1l2.500 2.500L8 1l2 2-2.500 2.500L10 8l-2 2-2.500-2.500L3 10 1 8l2.500-2.500z"/>',
  undecided: '<path d="M5.500 0 11 5.500 5.500 11 0 5.500z"/>',
  dropped: '<path d="M4.500 0h2v11h-2z"/>',
};

function make(tag, classes = "", text = "", attributes = {}) {
  const node = document.createElement(tag);
  if (classes) node.className = classes;
  if (text !== "") node.textContent = text;
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

function verdictBadge(verdict, label = verdict) {
  const badge = make("span", `verdict ${verdict}`);
  const mark = make("span", "mark", "", { "aria-hidden": "true" });
  mark.innerHTML = `<svg viewBox="0 0 11 11" fill="currentColor">${SHAPES[verdict]}</svg>`;
  badge.append(mark, label);
  return badge;
}

function twoColumns(rows) {
  const table = make("table", "pairs");
  for (const [name, value] of rows) {
    const row = make("tr");
    row.append(make("th", "", name, { scope: "row" }), make("td", /^[-\d.]/.test(String(value)) ? "num" : "", String(value)));
    table.append(row);
  }
  return table;
}

let statusTimer = 0;
function say(text) {
  byId("status").textContent = text;
  byId("status").classList.add("on");
  clearTimeout(statusTimer);
  statusTimer = setTimeout(() => byId("status").classList.remove("on"), 3500);
}

const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, "Liberation Sans", sans-serif';
const coarse = matchMedia("(pointer: coarse)");
const PLOT_CONFIG = { displayModeBar: false, responsive: true };

function axis(title, more = {}) {
  return {
    title: { text: title, standoff: 8, font: { size: 13, color: css("soft") } }, gridcolor: css("line"), linecolor: css("line"),
    zeroline: false, tickfont: { size: 12, color: css("soft") }, automargin: true, ...more,
  };
}

function layout(more = {}) {
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { family: FONT, size: 13, color: css("ink") },
    margin: { l: 48, r: 12, t: 8, b: 40 }, showlegend: false, hovermode: "closest", dragmode: coarse.matches ? false : "zoom",
    hoverlabel: { bgcolor: css("card"), bordercolor: css("line"), font: { family: FONT, size: 13, color: css("ink") }, align: "left" },
    ...more,
  };
}
