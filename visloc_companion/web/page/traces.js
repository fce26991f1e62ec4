// 95 % radius, protection level and alert limit over the last minutes.
import { niceStep } from "./project.js";
import { color } from "./styles.js";

const LONGEST_S = 600, LEFT = 44, BOTTOM = 20, TOP = 8;
const LINES = [[6, "--limit", [8, 5], 2.5], [5, "--text", [], 3], [4, "--aiding", [], 3]];

export function traces(canvas, samples, current) {
  const density = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * density);
  canvas.height = Math.round(height * density);
  const context = canvas.getContext("2d");
  context.scale(density, density);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = color("--dim");
  const known = samples.filter(Boolean);
  if (known.length < 2) {
    context.fillText("nothing yet", LEFT, height / 2);
    return;
  }
  const end = known[known.length - 1][0], length = Math.min(LONGEST_S, Math.max(60, end - known[0][0]));
  const levels = known.flatMap((s) => [s[4], s[5]]).filter((v) => v !== null), limit = Math.max(0, ...known.map((s) => s[6] ?? 0));
  const largest = Math.max(1, ...levels), top = Math.min(1.15 * Math.max(largest, limit <= 4 * largest ? limit : 0), 1e5);
  const x = (t) => LEFT + (width - LEFT - 6) * (1 - (end - t) / length), y = (v) => TOP + (height - TOP - BOTTOM) * (1 - v / top);
  axes(context, width, height, x, y, top, end, length, current ? "now" : "last");
  if (limit > top) context.fillText(`alert limit ${limit.toFixed(0)} m is above`, LEFT + 6, TOP + 10);
  context.beginPath();
  context.rect(LEFT, 0, width - LEFT, height - BOTTOM + 2);
  context.clip();
  for (const [k, name, dash, wide] of LINES) {
    Object.assign(context, { strokeStyle: color(name), lineWidth: wide, lineJoin: "round" });
    context.setLineDash(dash);
    context.beginPath();
    let on = false;
    for (const s of samples) {
      if (!s || s[k] === null) { on = false; continue; }
      if (on) context.lineTo(x(s[0]), y(s[k]));
      else context.moveTo(x(s[0]), y(s[k]));
      on = true;
    }
    context.stroke();
  }
}

function axes(context, width, height, x, y, top, end, length, newest) {
  context.strokeStyle = color("--grid");
  context.lineWidth = 1;
  context.beginPath();
  const step = niceStep(top / 2.5);
  for (let v = 0; v <= top; v += step) {
    context.moveTo(LEFT, y(v));
    context.lineTo(width, y(v));
    context.textAlign = "right";
    context.fillText(`${+v.toPrecision(3)} m`, LEFT - 5, y(v) + 4);
  }
  context.stroke();
  context.textAlign = "center";
  for (let back = 0; back <= length; back += length > 240 ? 120 : length > 100 ? 60 : 20) {
    if (x(end - back) > LEFT + 16) context.fillText(back ? `−${back >= 60 ? `${back / 60} min` : `${back} s`}` : newest, Math.min(x(end - back), width - 16), height - 4);
  }
  context.textAlign = "left";
}
