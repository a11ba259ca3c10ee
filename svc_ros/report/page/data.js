// What the page holds, and how scenes are unpacked from 16-bit text.
const data = JSON.parse(document.getElementById("report-data").textContent);
const VERDICTS = ["accepted", "rejected", "undecided", "dropped"];
const packed = new Map(data.scenes.map((scene) => [scene.index, scene]));

const totalDecisions = () => VERDICTS.reduce((sum, verdict) => sum + data.counts[verdict], 0);

function unpack(text, step) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Float32Array.from({ length: bytes.length / 2 }, (_, k) => view.getInt16(2 * k, true) * step);
}

function unpackSide(side, step) {
  const out = { origin: side.origin, numPoints: side.num_points, numLines: side.num_lines, numBlocked: side.num_blocked, numDenied: side.num_denied, numSeen: side.num_seen };
  for (const part of ["points", "clear", "blocked", "denied"]) out[part] = unpack(side[part], step);
  return out;
}

// One scene: index, verdict, placed, and for target and source: origin, points, clear, blocked, denied (x y z, ...).
function sceneOf(index) {
  const scene = packed.get(index);
  if (!scene) return null;
  return {
    index, placed: scene.placed, verdict: data.told[index].verdict,
    target: unpackSide(scene.target, scene.step_m), source: unpackSide(scene.source, scene.step_m),
  };
}
