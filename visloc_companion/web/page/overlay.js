// What lies over the map: trail, rings, vehicle, GNSS, scale bar, north, and the grid where there is no picture.
import { niceStep } from "./project.js";
import { TRAIL, color, plate, plateBeside, stroke } from "./styles.js";

export function grid(context, view) {
  const step = niceStep(160 / view.perMetre);
  context.strokeStyle = color("--grid");
  context.lineWidth = 1;
  context.beginPath();
  const [west, north] = view.ground(0, 0), [east, south] = view.ground(view.width, view.height);
  for (let e = Math.ceil(west / step) * step; e <= east; e += step) {
    const x = view.pixel([e, 0])[0];
    context.moveTo(x, 0);
    context.lineTo(x, view.height);
  }
  for (let n = Math.ceil(south / step) * step; n <= north; n += step) {
    const y = view.pixel([0, n])[1];
    context.moveTo(0, y);
    context.lineTo(view.width, y);
  }
  context.stroke();
}

export function trail(context, view, local, samples) {
  let run = [];
  const flush = () => {
    if (run.length > 1) {
      const points = run.map((s) => view.pixel(local.at(s[1], s[2])));
      stroke(context, (c) => points.forEach(([x, y], k) => (k ? c.lineTo(x, y) : c.moveTo(x, y))), TRAIL[run[0][3]] ?? TRAIL.unknown);
    }
    run = [];
  };
  for (const sample of samples) {
    if (!sample || sample[1] === null) { flush(); continue; }
    if (run.length && run[0][3] !== sample[3]) {
      const joint = run[run.length - 1];
      flush();
      run.push([joint[0], joint[1], joint[2], sample[3]]);
    }
    run.push(sample);
  }
  flush();
}

export function circle(context, view, centre, radius, style, words) {
  const [x, y] = view.pixel(centre), pixels = radius * view.perMetre;
  if (!(pixels > 0) || pixels > 1e5) return;
  stroke(context, (c) => c.arc(x, y, pixels, 0, 2 * Math.PI), style);
  const top = y - pixels, side = pixels * Math.SQRT1_2;
  if (words && pixels > 14) plate(context, words, x + (style.dash?.length ? -side : side), top > 12 ? y - side : y + side, style.dash?.length ? "right" : "left");
}

export function ellipse(context, view, centre, shape) {
  const [x, y] = view.pixel(centre), major = shape.semi_major_m * view.perMetre, minor = shape.semi_minor_m * view.perMetre;
  if (!(major > 1) || major > 1e5) return;
  const turn = (shape.azimuth_deg - 90) * Math.PI / 180;
  context.save();
  context.globalAlpha = 0.3;
  context.fillStyle = color("--aiding");
  context.beginPath();
  context.ellipse(x, y, major, Math.max(1, minor), turn, 0, 2 * Math.PI);
  context.fill();
  context.restore();
  stroke(context, (c) => c.ellipse(x, y, major, Math.max(1, minor), turn, 0, 2 * Math.PI), { color: "--aiding", width: 2 });
}

export function vehicle(context, view, centre, directionDeg, current) {
  const [x, y] = view.pixel(centre);
  context.save();
  context.translate(x, y);
  context.lineWidth = 3;
  context.fillStyle = current ? color("--text") : color("--plate");
  context.strokeStyle = current ? color("--ground") : color("--text");
  context.beginPath();
  if (directionDeg === null) context.arc(0, 0, 9, 0, 2 * Math.PI);
  else {
    context.rotate(directionDeg * Math.PI / 180);
    context.moveTo(0, -18);
    context.lineTo(12, 14);
    context.lineTo(0, 7);
    context.lineTo(-12, 14);
    context.closePath();
  }
  context.stroke();
  context.fill();
  if (!current) {
    context.lineWidth = 2;
    context.stroke();
  }
  context.restore();
}

// A diamond; crossed out where GNSS is not trusted
export function gnss(context, view, at, own, verdict) {
  const [x, y] = view.pixel(at);
  if (own) {
    const [ox, oy] = view.pixel(own);
    if (Math.hypot(x - ox, y - oy) > 40) stroke(context, (c) => { c.moveTo(ox, oy); c.lineTo(x, y); }, { color: "--gnss", width: 1.5, dash: [4, 4] });
  }
  const diamond = (c) => { c.moveTo(x, y - 11); c.lineTo(x + 11, y); c.lineTo(x, y + 11); c.lineTo(x - 11, y); c.closePath(); };
  stroke(context, diamond, { color: "--gnss", width: 3 });
  if (verdict !== "ok") stroke(context, (c) => { c.moveTo(x - 9, y - 9); c.lineTo(x + 9, y + 9); c.moveTo(x + 9, y - 9); c.lineTo(x - 9, y + 9); }, { color: "--gnss", width: 3 });
  plateBeside(context, verdict === "ok" ? "GNSS" : "GNSS, not trusted", x, y, 16, view.width);
}

export function scaleBar(context, view) {
  const metres = niceStep(130 / view.perMetre), wide = metres * view.perMetre, x = 12, y = view.height - 16;
  context.fillStyle = color("--plate");
  context.fillRect(x - 6, y - 30, Math.max(wide, 60) + 12, 38);
  plate(context, metres >= 1000 ? `${metres / 1000} km` : `${+metres.toPrecision(2)} m`, x, y - 18);
  stroke(context, (c) => { c.moveTo(x, y - 6); c.lineTo(x, y); c.lineTo(x + wide, y); c.lineTo(x + wide, y - 6); }, { color: "--text", width: 2.5 });
}

export function northArrow(context, view) {
  const x = view.width - 26;
  context.save();
  context.fillStyle = color("--plate");
  context.fillRect(x - 17, 8, 34, 58);
  context.fillStyle = color("--text");
  context.beginPath();
  [[x, 12], [x + 9, 40], [x, 33], [x - 9, 40]].forEach(([a, b], k) => (k ? context.lineTo(a, b) : context.moveTo(a, b)));
  context.fill();
  context.font = "700 15px system-ui, sans-serif";
  context.textAlign = "center";
  context.fillText("N", x, 58);
  context.restore();
}

// An arrow at the edge where the vehicle is out of sight
export function pointTo(context, view, centre) {
  const [x, y] = view.pixel(centre), inside = x > 0 && y > 0 && x < view.width && y < view.height;
  if (inside) return;
  const cx = Math.min(view.width - 70, Math.max(70, x)), cy = Math.min(view.height - 24, Math.max(24, y));
  plate(context, "vehicle is this way", cx, cy, "center");
  stroke(context, (c) => { c.moveTo(cx, cy + (y > cy ? 12 : -12)); c.lineTo(Math.min(view.width - 4, Math.max(4, x)), Math.min(view.height - 4, Math.max(4, y))); }, { color: "--text", width: 3 });
}
