// Fills in the texts. All words of the flight come from the server; here numbers get their units.
import { TRAIL, color } from "./styles.js";

const TONE = { aiding: "calm", shadow: "good", dead_reckoning: "warn", lost: "bad", waiting: "warn", ok: "good", suspect: "warn", denied: "bad" };
const MARK = { true: "✓", false: "✗", null: "–" };
const TIMES = /[\d.]+ (s|min|h)( \d+ (s|min))?(?![a-z])/g;
const at = (id) => document.getElementById(id);
const put = (id, words) => { if (at(id).textContent !== words) at(id).textContent = words; };
const metres = (value) => (value === null ? "none" : `${value.toFixed(value < 10 ? 1 : 0)} m`);
export const span = (s) => (s === null ? "–" : s < 9.95 ? `${s.toFixed(1)} s` : s < 99.5 ? `${s.toFixed(0)} s` : s < 5970 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);

function badge(id, tone, strong, span) {
  const box = at(id);
  box.dataset.tone = tone;
  box.querySelector("strong").textContent = strong;
  box.querySelector("span").textContent = span;
}

function rows(id, items, make) {
  at(id).replaceChildren(...items.map((item) => {
    const row = document.createElement("li");
    make(row, item);
    return row;
  }));
}

function child(row, kind, words, name) {
  const made = row.appendChild(document.createElement(kind));
  made.textContent = words;
  if (name) made.className = name;
}

export function labels(view) {
  const { mode, gnss, integrity, injection, position, fix } = view;
  badge("mode", TONE[mode.name] ?? "warn", mode.label, mode.means);
  badge("verdict", TONE[gnss.verdict] ?? "warn", gnss.label, gnss.says[0] ?? "");
  const level = integrity.protection_level_m;
  badge("integrity", integrity.alert ? "bad" : integrity.available ? "good" : "warn", level === null ? (position ? "no level" : "none") : `± ${metres(level)}`, integrity.says);
  const given = `${injection.given} positions given so far; a journal does not say which went out`;
  const so_far = injection.sent !== null ? `${injection.sent} positions so far` : injection.given === undefined ? "" : given;
  if (injection.withheld) badge("sending", "bad", "NOT SENT", injection.withheld);
  else badge("sending", injection.now ? "calm" : "none", injection.now === null ? "–" : injection.now ? "SENDING" : "not sending", so_far);
  place(position, integrity);
  put("fix-source", fix.source);
  put("fix-age", fix.age_s === null ? "never" : span(fix.age_s));
  put("answer", fix.answer ? `${fix.answer.says}, ${span(fix.answer.age_s)} ago` : "none yet");
  rows("reasons", gnss.says, (row, words) => { row.textContent = words; });
  const satellites = gnss.n_satellites === null ? "" : `, ${gnss.n_satellites} satellites`;
  put("receiver", `${gnss.fix}${satellites}${gnss.h_acc_m === null || gnss.lat_deg === null ? "" : `, ± ${metres(gnss.h_acc_m)}`}${gnss.age_s > 2 ? `, ${span(gnss.age_s)} ago` : ""}`);
  put("gnss-off", gnss.off_m === null ? "–" : metres(gnss.off_m));
  rows("health", view.health, (row, part) => {
    row.dataset.ok = part.ok === null ? "none" : part.ok;
    child(row, "span", MARK[part.ok], "mark");
    child(row, "span", part.part);
    child(row, "span", part.says);
  });
  rows("notices", view.notices.length ? view.notices : [{ text: "nothing yet", severity: "info", age_s: null }], (row, notice) => {
    row.dataset.severity = notice.severity;
    child(row, "time", notice.age_s === null ? "" : `${span(notice.age_s)} ago`);
    child(row, "span", notice.text);
  });
}

function place(position, integrity) {
  const { protection_level_m: level, vertical_protection_level_m: vertical, vertical_alert_limit_m: verticalLimit, alert_limit_m: limit } = integrity;
  const of = (value, most) => (value === null ? "–" : most === null ? metres(value) : `${metres(value)} of ${metres(most)}`);
  put("radius", position?.radius_95_m == null ? "–" : metres(position.radius_95_m));
  put("level", of(level, limit));
  put("vertical", of(vertical, verticalLimit));
  put("place", position ? `${position.lat_deg.toFixed(6)}, ${position.lon_deg.toFixed(6)}` : "not known");
  const height = position?.h_amsl_m == null ? "–" : `${position.h_amsl_m.toFixed(0)} m AMSL`;
  put("motion", position?.speed_mps == null ? height : `${height}, ${position.speed_mps.toFixed(1)} m/s`);
  put("direction-name", position?.direction_is ?? "heading");
  put("direction", position?.direction_deg == null ? "–" : `${String(Math.round(position.direction_deg) % 360).padStart(3, "0")}°`);
}

// Banners: what is wrong, and that a recording is shown. `silent_s`: since the page heard its own server.
export function banners(view, silent_s) {
  const lost = !view || silent_s > view.stale_after_s;
  const says = !view ? "The page's server does not answer." : lost ? `The page's server has not answered for ${span(silent_s)}: what is shown is what was known then.` : view.says;
  document.body.dataset.state = !view ? "absent" : lost ? "stale" : view.state;
  put("problem", says);
  put("spoken", says.replace(TIMES, "a while")); // else a screen reader would speak with every second
  at("problem").hidden = !says;
  const recording = view?.source.recording;
  at("recording").hidden = !recording;
  if (recording) put("recording", `RECORDING of ${view.source.name}, ${view.source.speed} × real time: not what happens now`);
  if (view) put("source", `${recording ? "recording" : "daemon at"} ${view.source.name}`);
  document.title = view ? `${recording ? "recording · " : ""}${document.body.dataset.state === "live" ? view.mode.label : "NO DATA"} · visloc` : "visloc";
}

const OTHERS = [["95 % ellipse", "--aiding", [], 2], ["protection level", "--text", [], 3.5], ["alert limit", "--limit", [10, 6], 2.5], ["GNSS (crossed out: not trusted)", "--gnss", [4, 4], 2]];

export function legend() {
  const trails = ["shadow", "aiding", "dead_reckoning", "lost"].map((name) => [`trail: ${TRAIL[name].words}`, TRAIL[name].color, TRAIL[name].dash, TRAIL[name].width]);
  rows("legend", [...trails, ...OTHERS], (row, [words, name, dash, width]) => {
    const canvas = row.appendChild(document.createElement("canvas"));
    [canvas.width, canvas.height] = [80, 32];
    const context = canvas.getContext("2d");
    context.scale(2, 2);
    Object.assign(context, { strokeStyle: color(name), lineWidth: width, lineCap: dash[0] < 4 ? "round" : "butt" });
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(2, 8);
    context.lineTo(38, 8);
    context.stroke();
    child(row, "span", words);
  });
}
