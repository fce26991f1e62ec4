// Metres east and north of an origin, and a canvas's pixels. One view holds tens of kilometres, where this is good to 1e-3.
const A = 6378137, E2 = 0.00669437999014;

export class Local {
  constructor(latDeg, lonDeg) {
    const phi = latDeg * Math.PI / 180, w = 1 - E2 * Math.sin(phi) ** 2;
    this.lat = latDeg;
    this.lon = lonDeg;
    this.perLat = Math.PI / 180 * A * (1 - E2) / w ** 1.5;
    this.perLon = Math.PI / 180 * A * Math.cos(phi) / Math.sqrt(w);
  }
  // [east, north] in metres; across the antimeridian by the shorter way
  at(latDeg, lonDeg) {
    const dLon = ((lonDeg - this.lon + 540) % 360 + 360) % 360 - 180;
    return [dLon * this.perLon, (latDeg - this.lat) * this.perLat];
  }
}

export class View {
  constructor() {
    this.east = 0;
    this.north = 0;
    this.perMetre = 1; // CSS pixels a metre
    this.width = this.height = 1;
  }
  pixel([east, north]) {
    return [this.width / 2 + (east - this.east) * this.perMetre, this.height / 2 - (north - this.north) * this.perMetre];
  }
  ground(x, y) {
    return [this.east + (x - this.width / 2) / this.perMetre, this.north - (y - this.height / 2) / this.perMetre];
  }
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const before = this.ground(x, y);
    this.perMetre = Math.min(200, Math.max(0.002, this.perMetre * factor));
    const after = this.ground(x, y);
    this.east += before[0] - after[0];
    this.north += before[1] - after[1];
  }
  move(dx, dy) {
    this.east -= dx / this.perMetre;
    this.north += dy / this.perMetre;
  }
  show(west, south, east, north) {
    this.east = (west + east) / 2;
    this.north = (south + north) / 2;
    this.perMetre = 0.95 * Math.min(this.width / Math.max(1, east - west), this.height / Math.max(1, north - south));
  }
}

// 1, 2 or 5 times a power of ten, at most `largest`
export function niceStep(largest) {
  const power = 10 ** Math.floor(Math.log10(largest));
  return power * (largest / power >= 5 ? 5 : largest / power >= 2 ? 2 : 1);
}
