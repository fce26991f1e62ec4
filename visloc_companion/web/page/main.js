// Listens to the server, keeps what it said, and says so when it falls silent.
import { Chart } from "./chart.js";
import { banners, labels, legend } from "./labels.js";
import { Stream } from "./stream.js";
import { traces } from "./traces.js";

const KEPT = 1200, AGAIN_MS = 2000;
const at = (id) => document.getElementById(id);
const chart = new Chart(at("map"), at("follow"));
let view = null, samples = [], began = null, heard = performance.now();

at("closer").onclick = () => chart.zoom(1.5);
at("wider").onclick = () => chart.zoom(1 / 1.5);
at("follow").onclick = () => chart.setFollow(!chart.following);
at("whole").onclick = () => chart.whole();

function show() {
  const silent = (performance.now() - heard) / 1000;
  banners(view, silent);
  if (!view) return;
  const stale = silent > view.stale_after_s;
  labels(view);
  chart.show(stale ? { ...view, state: "stale" } : view, samples);
  traces(at("traces"), samples, !stale && view.state === "live");
}

function take(said, late_s) {
  if (said.began !== began) samples = [];
  began = said.began;
  view = said.view;
  heard = performance.now() - 1000 * late_s;
  if (said.sample) samples.push(said.sample);
  else if (view.state !== "live" && samples.at(-1)) samples.push(null);
  samples = samples.slice(-KEPT);
  show();
}

// At every stream's beginning: the server may have been started anew, over another pack, whose tiles have other addresses
async function findMap() {
  try {
    const { map, problem } = await (await fetch("api/map")).json();
    chart.useMap(map);
    const note = problem ? `no map: ${problem}` : map ? "" : "no map: start visloc web with --map PACK";
    at("map-note").textContent = note;
    at("map-note").hidden = !note;
  } catch {
    setTimeout(findMap, AGAIN_MS);
  }
}

legend();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", legend);
addEventListener("resize", show);
const stream = new Stream((said) => {
  ({ samples, began } = said);
  findMap();
}, take);
setInterval(() => {
  stream.look();
  if (performance.now() - heard > 1000) show();
}, 500);
