// One pair in three dimensions.
const LAYERS = [
  { key: "target", name: "Target", swatch: "target", line: false },
  { key: "source", name: "Source", swatch: "source", line: false },
  { key: "denied", name: "Denied surface", swatch: "blocked", line: false },
  { key: "blocked", name: "Blocked sight lines", swatch: "blocked", line: true },
  { key: "clear", name: "Clear sight lines", swatch: "clear", line: true },
];
const CAMERAS = { behind: [-0.62, -0.78, 0.62], above: [0, -0.02, 1.3], side: [0, -1.25, 0.12] };
const hidden = new Set();
let chosenIndex = (data.scenes.find((scene) => data.told[scene.index].verdict === "rejected") || data.scenes[0] || { index: -1 }).index;
let camera = "behind";
let shown = null; // the scene that is drawn, unpacked

const every3 = (array, offset) => Array.from({ length: array.length / 3 }, (_, k) => array[3 * k + offset]);

function cloudTrace(side, name, layer) {
  const z = every3(side.points, 2);
  const sorted = [...z].sort((a, b) => a - b);
  return {
    type: "scatter3d", mode: "markers", name, hoverinfo: "skip", visible: !hidden.has(layer),
    x: every3(side.points, 0), y: every3(side.points, 1), z,
    marker: { size: 1.2 / narrowness(), color: z, cmin: sorted[Math.floor(0.05 * sorted.length)], cmax: sorted[Math.floor(0.95 * sorted.length)],
      colorscale: [[0, css(`${layer}-low`)], [1, css(layer)]], showscale: false },
  };
}

function lineTrace(sides, part, layer, style) {
  const x = [], y = [], z = [];
  for (const side of sides) {
    for (let k = 0; k < side[part].length; k += 3) {
      x.push(side.origin[0], side[part][k], null);
      y.push(side.origin[1], side[part][k + 1], null);
      z.push(side.origin[2], side[part][k + 2], null);
    }
  }
  return { type: "scatter3d", mode: "lines", name: layer, hoverinfo: "skip", visible: !hidden.has(layer), x, y, z, ...style };
}

function ringsAround(scene, size) {
  const spacing = [1, 2, 5, 10, 20, 50, 100].find((step) => size.radius / step <= 4) || 200;
  const z = size.ground, x = [], y = [], zs = [];
  for (let radius = spacing; radius <= size.radius * 1.05; radius += spacing) {
    for (let k = 0; k <= 72; k += 1) {
      x.push(scene.target.origin[0] + radius * Math.cos((k * Math.PI) / 36));
      y.push(scene.target.origin[1] + radius * Math.sin((k * Math.PI) / 36));
      zs.push(z);
    }
    x.push(null); y.push(null); zs.push(null);
  }
  return { spacing, x, y, z: zs };
}

// Where most of the points are: middle, radius around the target's sensor, level of the ground, and all extents.
function measure(scene) {
  const both = [scene.target.points, scene.source.points];
  const axes = [0, 1, 2].map((offset) => both.flatMap((points) => every3(points, offset)));
  const origin = scene.target.origin;
  const ranges = axes[0].map((x, k) => Math.hypot(x - origin[0], axes[1][k] - origin[1])).sort((a, b) => a - b);
  const heights = [...axes[2]].sort((a, b) => a - b);
  const bound = (values, more, pick) => values.concat(more).reduce((a, b) => pick(a, b));
  const origins = [scene.target.origin, scene.source.origin];
  const low = axes.map((values, k) => bound(values, origins.map((o) => o[k]), Math.min));
  const high = axes.map((values, k) => bound(values, origins.map((o) => o[k]), Math.max));
  return { low, high, radius: Math.max(2, ranges[Math.floor(0.9 * ranges.length)] || 2), ground: heights[Math.floor(0.05 * heights.length)] || 0 };
}

// At least 1, and more on a phone, which sees less to the sides and has to stand farther back.
function narrowness() {
  const box = byId("view3d");
  return Math.max(1, (1.25 * box.clientHeight) / Math.max(box.clientWidth, 1));
}

function sceneLayout(size, scene) {
  const span = size.high.map((value, k) => Math.max(value - size.low[k], 0.5));
  const longest = Math.max(...span);
  const middle = size.high.map((value, k) => (value + size.low[k]) / 2);
  const focus = scene.target.origin.map((value, k) => ((value + scene.source.origin[k]) / 2 - middle[k]) / longest);
  focus[2] = (size.ground - middle[2]) / longest;
  const reach = (1.75 * narrowness() * size.radius) / longest;
  const eye = CAMERAS[camera].map((value, k) => focus[k] + value * reach);
  const blank = (k) => ({ visible: false, range: [size.low[k], size.high[k]], showspikes: false });
  return {
    aspectmode: "manual", aspectratio: { x: span[0] / longest, y: span[1] / longest, z: span[2] / longest },
    xaxis: blank(0), yaxis: blank(1), zaxis: blank(2), bgcolor: css("sky"), dragmode: "orbit",
    camera: { eye: { x: eye[0], y: eye[1], z: eye[2] }, center: { x: focus[0], y: focus[1], z: focus[2] }, up: { x: 0, y: 0, z: 1 } },
  };
}

function traces3d(scene, size) {
  const sides = [scene.target, scene.source];
  const rings = ringsAround(scene, size);
  const denied = { x: [], y: [], z: [] };
  for (const side of sides) ["x", "y", "z"].forEach((name, k) => denied[name].push(...every3(side.denied, k)));
  const origin = (side, name, colour) => ({
    type: "scatter3d", mode: "markers", name, hoverinfo: "skip", x: [side.origin[0]], y: [side.origin[1]], z: [side.origin[2]],
    marker: { size: 6, symbol: "diamond", color: colour, line: { width: 1, color: css("sky") } },
  });
  return { spacing: rings.spacing, traces: [
    { type: "scatter3d", mode: "lines", name: "rings", hoverinfo: "skip", x: rings.x, y: rings.y, z: rings.z, line: { color: css("ring"), width: 1 } },
    cloudTrace(scene.target, "target", "target"),
    cloudTrace(scene.source, "source", "source"),
    lineTrace(sides, "clear", "clear", { line: { color: css("clear"), width: 1 }, opacity: 0.4 }),
    lineTrace(sides, "blocked", "blocked", { line: { color: css("blocked"), width: 1 }, opacity: 0.25 }),
    { type: "scatter3d", mode: "markers", name: "denied", hoverinfo: "skip", visible: !hidden.has("denied"), ...denied, marker: { size: 1.9 / narrowness(), color: css("blocked") } },
    origin(scene.target, "target sensor", css("origin")),
    origin(scene.source, "source sensor", css("source")),
  ] };
}

function drawScene() {
  if (!shown) return;
  const size = measure(shown);
  const { traces, spacing } = traces3d(shown, size);
  Plotly.react(byId("view3d"), traces, layout({ scene: sceneLayout(size, shown), margin: { l: 0, r: 0, t: 0, b: 0 } }),
    { displaylogo: false, responsive: true, displayModeBar: false, scrollZoom: true });
  const { target, source } = shown;
  const both = (name) => target[name] + source[name];
  const lines = both("numLines"), blocked = both("numBlocked"), denied = both("numDenied"), seen = both("numSeen");
  const drawn = (part, total) => `${whole((target[part].length + source[part].length) / 3)} of ${whole(total)}`;
  byId("view3d-note").textContent =
    `${seen ? `${((100 * denied) / seen).toFixed(1)} % of the surface that the other sensor could see is denied. ` : ""}` +
    `${lines ? `${((100 * blocked) / lines).toFixed(1)} % of all sight lines are blocked. ` : ""}` +
    `Drawn: ${drawn("points", both("numPoints"))} points, ${drawn("denied", denied)} denied ones, ${drawn("blocked", blocked)} blocked ` +
    `and ${drawn("clear", lines - blocked)} clear sight lines of both sensors (diamonds). Rings ${spacing} m apart around the target's sensor.` +
    `${shown.placed ? "" : " No pose was found: the source stands in its own frame."}`;
  describe("view3d", `Decision ${shown.index}, ${shown.verdict}: ${denied} of ${seen} points denied, ${blocked} of ${lines} sight lines blocked.`);
}

function turnCamera(aroundDeg, upDeg, nearer) {
  const div = byId("view3d");
  const { eye, center } = div.layout.scene.camera;
  const arm = [eye.x - center.x, eye.y - center.y, eye.z - center.z];
  const length = Math.hypot(...arm) * nearer;
  const azimuth = Math.atan2(arm[1], arm[0]) + (aroundDeg * Math.PI) / 180;
  const flat = Math.hypot(arm[0], arm[1]);
  const height = Math.min(1.5, Math.max(-1.5, Math.atan2(arm[2], flat) + (upDeg * Math.PI) / 180));
  Plotly.relayout(div, { "scene.camera.eye": {
    x: center.x + length * Math.cos(height) * Math.cos(azimuth), y: center.y + length * Math.cos(height) * Math.sin(azimuth), z: center.z + length * Math.sin(height),
  } });
}

function setUpView() {
  for (const layer of LAYERS) {
    const chip = make("label", "chip");
    const box = make("input", "", "", { type: "checkbox", name: layer.key });
    box.checked = true;
    box.addEventListener("change", () => {
      if (box.checked) hidden.delete(layer.key); else hidden.add(layer.key);
      const places = byId("view3d").data.flatMap((trace, k) => (trace.name === layer.key ? [k] : []));
      Plotly.restyle(byId("view3d"), { visible: box.checked }, places);
    });
    const swatch = make("span", layer.line ? "swatch line" : "swatch", "", { "aria-hidden": "true" });
    swatch.style.setProperty("--swatch", `var(--${layer.swatch})`);
    chip.append(box, swatch, layer.name);
    byId("layers").append(chip);
  }
  for (const [name, label] of [["behind", "Askew"], ["above", "From above"], ["side", "From the side"]]) {
    const button = make("button", "", label, { type: "button" });
    button.addEventListener("click", () => { camera = name; drawScene(); });
    byId("cameras").append(button);
  }
  byId("view3d").addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [10, 0, 1], ArrowRight: [-10, 0, 1], ArrowUp: [0, 8, 1], ArrowDown: [0, -8, 1], "+": [0, 0, 0.85], "=": [0, 0, 0.85], "-": [0, 0, 1.18] }[event.key];
    if (!turn || !shown) return;
    event.preventDefault();
    turnCamera(...turn);
  });
}
