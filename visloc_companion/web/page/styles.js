// How modes are drawn: by colour and by dashes, so that either tells them apart. Colours come from page.css.
export const TRAIL = {
  shadow: { color: "--shadow", dash: [], width: 4, words: "SHADOW" },
  aiding: { color: "--aiding", dash: [], width: 6, words: "AIDING" },
  dead_reckoning: { color: "--dead", dash: [12, 6], width: 5, words: "DEAD RECKONING" },
  lost: { color: "--lost", dash: [2, 7], width: 5, words: "LOST" },
  waiting: { color: "--waiting", dash: [2, 10], width: 3, words: "WAITING" },
  unknown: { color: "--waiting", dash: [2, 10], width: 3, words: "unknown mode" },
};

export function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

// Over pictures of any brightness a line needs a rim
export function stroke(context, path, { color: name, dash = [], width = 3 }) {
  context.save();
  context.lineJoin = context.lineCap = dash.length ? "butt" : "round";
  if (dash.length && dash[0] < 4) context.lineCap = "round";
  context.setLineDash(dash);
  for (const [style, wide] of [[color("--plate"), width + 3], [color(name), width]]) {
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.beginPath();
    path(context);
    context.stroke();
  }
  context.restore();
}

const PLATE_FONT = "600 13px system-ui, sans-serif";

// Words beside (x, y), moved in where they would be cut off at a side of the map that (x, y) lies on
export function plate(context, words, x, y, align = "left") {
  context.save();
  context.font = PLATE_FONT;
  const wide = context.measureText(words).width + 8, most = context.canvas.clientWidth;
  const wished = align === "center" ? x - wide / 2 : align === "right" ? x - wide : x;
  const left = x < 0 || x > most ? wished : Math.max(0, Math.min(wished, most - wide));
  context.fillStyle = color("--plate");
  context.fillRect(left, y - 10, wide, 20);
  context.fillStyle = color("--text");
  context.textBaseline = "middle";
  context.fillText(words, left + 4, y + 1);
  context.restore();
}

// Words beside a place: to its right, or where they would be cut off there, to its left
export function plateBeside(context, words, x, y, gap, right) {
  context.save();
  context.font = PLATE_FONT;
  const fits = x + gap + context.measureText(words).width + 8 <= right;
  context.restore();
  plate(context, words, fits ? x + gap : x - gap, y, fits ? "left" : "right");
}
