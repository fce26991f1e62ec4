// The map: holds what is shown, and lets it be panned, zoomed and followed. Draws at most once a frame.
import * as over from "./overlay.js";
import { Local, View } from "./project.js";
import { Tiles } from "./tiles.js";

const FAR_M = 200000; // further than this from where the drawing began, it begins anew
const FIRST_WIDTH_M = 250, LIMITS = 5, NARROW_PX = 500;

export class Chart {
  constructor(canvas, followButton) {
    Object.assign(this, { canvas, followButton });
    this.view = new View();
    this.samples = [];
    this.local = this.tiles = this.shown = null;
    this.pointers = new Map();
    this.setFollow(true);
    new ResizeObserver(() => this.resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    this.listen();
    this.resize();
  }

  // A map as /api/map describes it, or null
  useMap(map) {
    if (map?.identity === this.tiles?.identity) return;
    if (!map) {
      this.tiles = null;
      this.draw();
      return;
    }
    const middle = map.places[Math.floor(map.places.length / 2)];
    this.local = new Local(...middle);
    this.tiles = new Tiles(map, this.local, () => this.draw());
    if (!this.placed || !this.following) this.view.show(...this.tiles.bounds());
    this.setFollow(this.following);
  }

  show(view, samples) {
    const first = !this.placed;
    this.shown = view;
    this.samples = samples;
    const place = view.position;
    if (place) {
      if (!this.local || this.far(place)) this.begin(place);
      if (this.following) [this.view.east, this.view.north] = this.own();
      if (first) this.view.perMetre = Math.min(this.view.width, this.view.height) / Math.max(FIRST_WIDTH_M, LIMITS * (view.integrity.alert_limit_m ?? 0));
      this.placed = true;
    }
    this.draw();
  }

  far(place) {
    const [east, north] = this.local.at(place.lat_deg, place.lon_deg);
    return !this.tiles && Math.hypot(east, north) > FAR_M;
  }

  begin(place) {
    this.local = new Local(place.lat_deg, place.lon_deg);
    this.setFollow(true);
  }

  own() {
    return this.local.at(this.shown.position.lat_deg, this.shown.position.lon_deg);
  }

  whole() {
    this.setFollow(false);
    if (this.tiles) this.view.show(...this.tiles.bounds());
    else if (this.local) {
      const points = this.samples.filter((s) => s && s[1] !== null).map((s) => this.local.at(s[1], s[2]));
      const east = points.map((p) => p[0]), north = points.map((p) => p[1]);
      if (points.length) this.view.show(Math.min(...east) - 50, Math.min(...north) - 50, Math.max(...east) + 50, Math.max(...north) + 50);
    }
    this.draw();
  }

  setFollow(on) {
    this.following = on;
    this.followButton.setAttribute("aria-pressed", String(on));
    if (on && this.shown?.position && this.local) [this.view.east, this.view.north] = this.own();
    this.draw();
  }

  zoom(factor, x, y) {
    this.view.zoom(factor, this.following ? undefined : x, this.following ? undefined : y);
    this.draw();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas, density = devicePixelRatio || 1;
    this.view.width = Math.max(1, clientWidth);
    this.view.height = Math.max(1, clientHeight);
    this.canvas.width = Math.round(clientWidth * density);
    this.canvas.height = Math.round(clientHeight * density);
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.paint();
    });
  }

  paint() {
    const context = this.canvas.getContext("2d"), density = devicePixelRatio || 1, { view } = this;
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    over.grid(context, view);
    if (this.tiles) this.tiles.draw(context, view, density);
    if (this.local) this.paintFlight(context, view);
    over.northArrow(context, view);
    if (this.local) over.scaleBar(context, view);
  }

  paintFlight(context, view) {
    over.trail(context, view, this.local, this.samples);
    const shown = this.shown, position = shown?.position;
    if (!shown) return;
    const { gnss, integrity } = shown, own = position ? this.own() : null;
    if (own) {
      const { protection_level_m: level, alert_limit_m: limit } = integrity, narrow = view.width < NARROW_PX;
      if (limit !== null) over.circle(context, view, own, limit, { color: "--limit", width: 2.5, dash: [10, 6] }, `${narrow ? "" : "alert "}limit ${limit.toFixed(0)} m`);
      if (position.ellipse_95) over.ellipse(context, view, own, position.ellipse_95);
      if (level !== null) over.circle(context, view, own, level, { color: "--text", width: 3.5 }, `${narrow ? "" : "protection "}level ${level.toFixed(level < 10 ? 1 : 0)} m`);
    }
    if (gnss.lat_deg !== null) over.gnss(context, view, this.local.at(gnss.lat_deg, gnss.lon_deg), own, gnss.verdict);
    if (own) {
      over.vehicle(context, view, own, position.direction_deg, shown.state === "live");
      over.pointTo(context, view, own);
    }
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-Math.sign(event.deltaY) * Math.min(0.4, Math.abs(event.deltaY) / 300)), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => this.dragged(event));
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
      if (steps) { this.setFollow(false); this.view.move(...steps); this.draw(); }
      else if (event.key === "+" || event.key === "-") this.zoom(event.key === "+" ? 1.4 : 1 / 1.4);
      else return;
      event.preventDefault();
    });
  }

  dragged(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const other = [...this.pointers.values()].find((p) => p.pointerId !== event.pointerId);
    if (other) {
      const gap = (p) => Math.max(10, Math.hypot(p.offsetX - other.offsetX, p.offsetY - other.offsetY));
      this.zoom(gap(event) / gap(before), (event.offsetX + other.offsetX) / 2, (event.offsetY + other.offsetY) / 2);
    } else {
      this.setFollow(false);
      this.view.move(event.offsetX - before.offsetX, event.offsetY - before.offsetY);
    }
    this.pointers.set(event.pointerId, event);
    this.draw();
  }
}
