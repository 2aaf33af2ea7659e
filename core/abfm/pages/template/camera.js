// One camera for all panels: rotated about the vertical, tilted, zoomed and moved.

const PITCH_MAX = Math.PI / 2, ZOOM_RANGE = [0.3, 40], MARGIN = 0.88;
const DEPTH_MARGIN = 1.2; // depth range for objects in front of the surface

class Camera {
  /** Fits all meshes, each in the axes of its panel, at any rotation. */
  constructor(panels) {
    this.panels = panels;
    this.density = 1;
    this.setFront(IDENTITY);
    const reach = Math.max(...this.extents.map(([, , total]) => total));
    this.distance = 5 * reach;
    this.radius = DEPTH_MARGIN * reach;
  }

  /** Rotates the fronts of all panels; further rotations start from there. */
  setFront(rotation) {
    this.axes = this.panels.map(({ axes }) => product(rotation, axes));
    this.extents = this.panels.map(({ mesh }, number) => extent(mesh.positions, this.axes[number]));
    this.reset();
  }

  /** Turns an axis of the last panel's mesh (0, 1 or 2) upwards; null restores the front. */
  setUpAxis(axis) {
    if (axis === null) return this.setFront(IDENTITY);
    const { axes } = this.panels[this.panels.length - 1], up = [0, 0, 0];
    up[axis] = 1;
    let front = axes.slice(6);
    front[axis] = 0;
    if (Math.hypot(...front) < 0.1) front = axes.slice(3, 6).map((x, k) => (k === axis ? 0 : -x));
    const length = Math.hypot(...front);
    front = front.map((x) => x / length);
    return this.setFront(product([...cross(up, front), ...up, ...front], transposed(axes)));
  }

  reset() {
    [this.yaw, this.pitch, this.zoom, this.pan] = [0, 0, 1, [0, 0]];
  }

  /** Rotates by the pixels of a drag; a drag across the panel is half a turn. */
  turn(dx, dy, size) {
    this.yaw += (Math.PI * dx) / size;
    this.pitch = Math.min(Math.max(this.pitch + (Math.PI * dy) / size, -PITCH_MAX), PITCH_MAX);
  }

  move(dx, dy) {
    this.pan = [this.pan[0] + dx, this.pan[1] - dy];
  }

  /** Zooms about a point, in pixels from the centre of a panel. */
  zoomBy(factor, center = [0, 0]) {
    const zoom = Math.min(Math.max(this.zoom * factor, ZOOM_RANGE[0]), ZOOM_RANGE[1]);
    const by = zoom / this.zoom;
    this.pan = this.pan.map((p, i) => center[i] + (p - center[i]) * by);
    this.zoom = zoom;
  }

  /** Sets the size of a unit in CSS pixels so that all meshes fit boxes [.., width, height]. */
  fit(boxes) {
    const each = boxes.map(([, , width, height], i) =>
      Math.min(width / this.extents[i][0], height / this.extents[i][1]));
    this.unit = (MARGIN * Math.min(...each)) / 2;
  }

  /** Scale and shift of the projection to a box of device pixels. */
  projection([, , width, height]) {
    const unit = 2 * this.unit * this.zoom * this.density;
    return {
      scale: [unit / width, unit / height],
      pan: [(2 * this.density * this.pan[0]) / width, (2 * this.density * this.pan[1]) / height],
    };
  }

  /** Rotation matrix of a panel, by rows. */
  rotationOf(number) {
    const [s, c, t, d] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch),
      Math.cos(this.pitch)];
    const turn = [c, 0, s, t * s, d, -t * c, -d * s, t, d * c];
    return product(turn, this.axes[number]);
  }

  /** Position of a point: (x, y) in CSS pixels from the centre of the box, y upwards; depth. */
  project(turn, point) {
    const [x, y, z] = times(turn, point);
    const unit = (this.unit * this.zoom * this.distance) / (this.distance - z);
    return [x * unit + this.pan[0], y * unit + this.pan[1], z];
  }
}

const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];

/** Radii of a mesh in rotated axes: around the vertical, vertical, and total. */
function extent(positions, axes) {
  let across = 0, up = 0, total = 1e-9;
  for (let i = 0; i < positions.length; i += 3) {
    const [x, y, z] = times(axes, positions.subarray(i, i + 3));
    across = Math.max(across, Math.hypot(x, z));
    up = Math.max(up, Math.abs(y));
    total = Math.max(total, Math.hypot(x, y, z));
  }
  return [across, up, total];
}

const transposed = (m) => [0, 1, 2].flatMap((row) => [m[row], m[row + 3], m[row + 6]]);

const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

/** Product of two matrices, by rows. */
const product = (m, n) => {
  const columns = transposed(n);
  const found = [0, 1, 2].map((k) => times(m, columns.slice(3 * k, 3 * k + 3)));
  return transposed(found.flat());
};

/** Product of a matrix, by rows, and a vector. */
const times = (m, [x, y, z]) => [
  m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z,
];

/** Rotates, zooms and moves by mouse and touch; calls `changed` after each change. */
function followPointers(element, camera, panelAt, changed) {
  const pointers = new Map();
  const center = () => {
    const all = [...pointers.values()], mean = (k) => all.reduce((s, p) => s + p[k], 0) / all.length;
    const [x, y] = [mean(0), mean(1)];
    const [one, other] = [all[0], all[all.length - 1]];
    return { x, y, spread: Math.hypot(one[0] - other[0], one[1] - other[1]) };
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  element.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = center();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const now = center(), [dx, dy] = [now.x - before.x, now.y - before.y];
    const { size, from } = panelAt(now.x, now.y);
    if (pointers.size > 1 || event.shiftKey || event.buttons & 6) camera.move(dx, dy);
    else camera.turn(dx, dy, size);
    if (pointers.size > 1 && before.spread > 0) camera.zoomBy(now.spread / before.spread, from);
    changed();
  });
  for (const kind of ["pointerup", "pointercancel"])
    element.addEventListener(kind, (event) => pointers.delete(event.pointerId));
  element.addEventListener("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    camera.zoomBy(Math.exp(-0.0015 * pixels), panelAt(event.clientX, event.clientY).from);
    changed();
  }, { passive: false });
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", () => {
    camera.reset();
    changed();
  });
}
