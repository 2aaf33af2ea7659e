// One camera for all panels: turned about the vertical and tilted, zoomed, moved.

const STEEPEST = Math.PI / 2, ZOOMS = [0.3, 40], MARGIN = 0.88;
const ROOM = 1.2; // for what is drawn on the surface and nearer to the eye

class Camera {
  /** Sees all of some meshes, each in the axes of its panel, however they turn. */
  constructor(panels) {
    this.panels = panels;
    this.density = 1;
    this.stand(IDENTITY);
    const farthest = Math.max(...this.extents.map(([, , far]) => far));
    this.distance = 5 * farthest;
    this.radius = ROOM * farthest;
  }

  /** Turns all panels by a rotation of what was their front, from which it goes on turning. */
  stand(rotation) {
    this.axes = this.panels.map(({ axes }) => product(rotation, axes));
    this.extents = this.panels.map(({ mesh }, number) => extent(mesh.positions, this.axes[number]));
    this.reset();
  }

  /** Puts an axis of the last panel's mesh upright, 0, 1 or 2; its own front for none. */
  upright(axis) {
    if (axis === null) return this.stand(IDENTITY);
    const own = this.panels[this.panels.length - 1].axes, up = [0, 0, 0];
    up[axis] = 1;
    let front = own.slice(6);
    front[axis] = 0;
    if (Math.hypot(...front) < 0.1) front = own.slice(3, 6).map((x, k) => (k === axis ? 0 : -x));
    const length = Math.hypot(...front);
    front = front.map((x) => x / length);
    return this.stand(product([...cross(up, front), ...up, ...front], transposed(own)));
  }

  reset() {
    [this.yaw, this.pitch, this.zoom, this.pan] = [0, 0, 1, [0, 0]];
  }

  /** Turns by pixels of a drag across a panel of some size. */
  turn(dx, dy, size) {
    this.yaw += (Math.PI * dx) / size;
    this.pitch = Math.min(Math.max(this.pitch + (Math.PI * dy) / size, -STEEPEST), STEEPEST);
  }

  move(dx, dy) {
    this.pan = [this.pan[0] + dx, this.pan[1] - dy];
  }

  /** Zooms about a place, in pixels from the middle of a panel. */
  nearer(factor, place = [0, 0]) {
    const zoom = Math.min(Math.max(this.zoom * factor, ZOOMS[0]), ZOOMS[1]);
    const by = zoom / this.zoom;
    this.pan = this.pan.map((p, i) => place[i] + (p - place[i]) * by);
    this.zoom = zoom;
  }

  /** Chooses the size of a unit in CSS pixels so that all fit their boxes [.., width, height]. */
  fit(boxes) {
    const each = boxes.map(([, , width, height], i) =>
      Math.min(width / this.extents[i][0], height / this.extents[i][1]));
    this.unit = (MARGIN * Math.min(...each)) / 2;
  }

  /** Scale and shift of what is seen in a box of device pixels. */
  placed([, , width, height]) {
    const unit = 2 * this.unit * this.zoom * this.density;
    return {
      scale: [unit / width, unit / height],
      pan: [(2 * this.density * this.pan[0]) / width, (2 * this.density * this.pan[1]) / height],
    };
  }

  /** The rotation (rows) of a panel. */
  turned(number) {
    const [s, c, t, d] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch),
      Math.cos(this.pitch)];
    const turn = [c, 0, s, t * s, d, -t * c, -d * s, t, d * c];
    return product(turn, this.axes[number]);
  }

  /** Where points of a panel are: (x, y) in CSS pixels from the middle of its box, up, and depth. */
  projected(turn, point) {
    const [x, y, z] = times(turn, point);
    const unit = (this.unit * this.zoom * this.distance) / (this.distance - z);
    return [x * unit + this.pan[0], y * unit + this.pan[1], z];
  }
}

const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];

/** How far a mesh reaches, seen along axes: around its vertical, up and down, in all. */
function extent(positions, axes) {
  let across = 0, up = 0, far = 1e-9;
  for (let i = 0; i < positions.length; i += 3) {
    const [x, y, z] = times(axes, positions.subarray(i, i + 3));
    across = Math.max(across, Math.hypot(x, z));
    up = Math.max(up, Math.abs(y));
    far = Math.max(far, Math.hypot(x, y, z));
  }
  return [across, up, far];
}

const transposed = (m) => [0, 1, 2].flatMap((row) => [m[row], m[row + 3], m[row + 6]]);

const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

/** The product of two matrices of rows. */
const product = (m, n) => {
  const columns = transposed(n);
  const made = [0, 1, 2].map((k) => times(m, columns.slice(3 * k, 3 * k + 3)));
  return transposed(made.flat());
};

/** A matrix of rows times a vector. */
const times = (m, [x, y, z]) => [
  m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z,
];

/** Lets mouse and fingers turn, zoom and move; `changed` is called after each. */
function follow(element, camera, panelAt, changed) {
  const held = new Map();
  const middle = () => {
    const all = [...held.values()], mean = (k) => all.reduce((s, p) => s + p[k], 0) / all.length;
    const [x, y] = [mean(0), mean(1)];
    const [one, other] = [all[0], all[all.length - 1]];
    return { x, y, spread: Math.hypot(one[0] - other[0], one[1] - other[1]) };
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  element.addEventListener("pointermove", (event) => {
    if (!held.has(event.pointerId)) return;
    const before = middle();
    held.set(event.pointerId, [event.clientX, event.clientY]);
    const now = middle(), [dx, dy] = [now.x - before.x, now.y - before.y];
    const { size, from } = panelAt(now.x, now.y);
    if (held.size > 1 || event.shiftKey || event.buttons & 6) camera.move(dx, dy);
    else camera.turn(dx, dy, size);
    if (held.size > 1 && before.spread > 0) camera.nearer(now.spread / before.spread, from);
    changed();
  });
  for (const kind of ["pointerup", "pointercancel"])
    element.addEventListener(kind, (event) => held.delete(event.pointerId));
  element.addEventListener("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    camera.nearer(Math.exp(-0.0015 * pixels), panelAt(event.clientX, event.clientY).from);
    changed();
  }, { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", () => {
    camera.reset();
    changed();
  });
}
