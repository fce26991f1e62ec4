// The orthophoto: which tiles are in view, fetched a few at a time; coarser ones stand in until they are there.
const MOST = 160, AT_ONCE = 3;

export class Tiles {
  constructor(map, local, onLoad) {
    Object.assign(this, map, { local, onLoad });
    this.images = new Map();
    this.loading = 0;
    this.corners = map.places.map(([lat, lon]) => local.at(lat, lon));
  }

  // Ground position of a raster corner, between the lattice's places
  ground(col, row) {
    const n = this.lattice - 1;
    const u = Math.min(1, col / this.cols) * n, v = Math.min(1, row / this.rows) * n;
    const i = Math.min(n - 1, Math.floor(u)), j = Math.min(n - 1, Math.floor(v)), a = u - i, b = v - j;
    const at = (di, dj) => this.corners[(j + dj) * this.lattice + i + di];
    const mix = (k) => (1 - b) * ((1 - a) * at(0, 0)[k] + a * at(1, 0)[k]) + b * ((1 - a) * at(0, 1)[k] + a * at(1, 1)[k]);
    return [mix(0), mix(1)];
  }

  bounds() {
    const east = this.corners.map((c) => c[0]), north = this.corners.map((c) => c[1]);
    return [Math.min(...east), Math.min(...north), Math.max(...east), Math.max(...north)];
  }

  draw(context, view, density) {
    const wanted = Math.log2(this.gsd_m * view.perMetre * density);
    const finest = this.levels - 1, level = Math.max(0, Math.min(finest, finest + Math.ceil(wanted)));
    this.wanted = [];
    this.drawNode(context, view, 0, 0, 0, level);
    this.wanted.sort((a, b) => a.split("/")[0] - b.split("/")[0]);
    this.fetch();
  }

  // A tile in view, and over it the four finer ones that it holds
  drawNode(context, view, level, col, row, finest) {
    const side = this.tile_px * 2 ** (this.levels - 1 - level);
    if (col * side >= this.cols || row * side >= this.rows) return;
    const [p, q, r] = this.frame(view, col * side, row * side, side);
    const xs = [p[0], q[0], r[0], q[0] + r[0] - p[0]], ys = [p[1], q[1], r[1], q[1] + r[1] - p[1]];
    if (Math.max(...xs) < 0 || Math.min(...xs) > view.width || Math.max(...ys) < 0 || Math.min(...ys) > view.height) return;
    const key = `${level}/${col}/${row}`, image = this.images.get(key);
    if (!image && (level === 0 || level === finest)) this.wanted.push(key);
    if (image?.ready) this.drawTile(context, image.picture, p, q, r);
    if (level === finest) return;
    for (const [i, j] of [[0, 0], [1, 0], [0, 1], [1, 1]]) this.drawNode(context, view, level + 1, 2 * col + i, 2 * row + j, finest);
  }

  // Pixels of a tile's top left, top right and bottom left corners, by the map's own shape within the raster
  frame(view, left, top, side) {
    const right = Math.min(left + side, this.cols), bottom = Math.min(top + side, this.rows);
    const p = view.pixel(this.ground(left, top)), q = view.pixel(this.ground(right, top)), r = view.pixel(this.ground(left, bottom));
    const grown = (to, share) => [p[0] + (to[0] - p[0]) * share, p[1] + (to[1] - p[1]) * share];
    return [p, grown(q, side / (right - left)), grown(r, side / (bottom - top))];
  }

  drawTile(context, picture, p, q, r) {
    const n = this.tile_px, seam = 0.4; // else the ground shows between tiles
    context.save();
    context.transform((q[0] - p[0]) / n, (q[1] - p[1]) / n, (r[0] - p[0]) / n, (r[1] - p[1]) / n, p[0], p[1]);
    const scale = Math.hypot(q[0] - p[0], q[1] - p[1]) / n;
    context.drawImage(picture, 0, 0, n + seam / scale, n + seam / scale);
    context.restore();
  }

  fetch() {
    for (const key of this.wanted) {
      if (this.loading >= AT_ONCE) return;
      const picture = new Image(), entry = { picture, ready: false };
      this.images.set(key, entry);
      this.loading += 1;
      const done = (ready) => {
        this.loading -= 1;
        entry.ready = ready;
        if (!ready) setTimeout(() => this.images.delete(key), 5000);
        this.onLoad();
      };
      picture.onload = () => done(true);
      picture.onerror = () => done(false);
      picture.src = `api/map/${this.identity}/${key}.webp`;
      if (this.images.size > MOST) this.images.delete([...this.images.keys()].find((k) => !k.startsWith("0/")));
    }
  }
}
