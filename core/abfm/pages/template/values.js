// Numbers: the value under the mouse, and how that of a vertex goes on in time, after a click.

const NEAR = 10; // pixels that a vertex may be from the mouse
const STILL = 4; // pixels that a click may move

class Values {
  constructor(panels, camera, state, player, panelAt) {
    Object.assign(this, { panels, camera, state, player, panelAt });
    this.under = this.chosen = null; // the vertex under the mouse, and the one that was clicked on
    this.stage = element("stage");
    this.tip = element("tip");
    this.plot = element("plot");
    let pressed = [Infinity, Infinity];
    this.stage.addEventListener("pointerleave", () => (this.tip.hidden = true));
    this.stage.addEventListener("pointerdown", (event) => {
      pressed = [event.clientX, event.clientY];
    });
    this.stage.addEventListener("pointermove", (event) => {
      if (event.buttons || event.pointerType !== "mouse") this.tip.hidden = true;
      else this.show(event);
    });
    this.stage.addEventListener("pointerup", (event) => {
      const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
      if (event.button === 0 && moved <= STILL) this.choose(this.nearest(event));
    });
  }

  /** The nearest vertex that is seen at the mouse, and its panel; null for none. */
  nearest({ clientX, clientY }) {
    const { number, from } = this.panelAt(clientX, clientY);
    if (number < 0) return null;
    const { mesh, count } = this.panels[number], turn = this.camera.turned(number);
    let best = -1, highest = -Infinity;
    for (let v = 0; v < count; v++) {
      const [x, y, z] = this.camera.projected(turn, mesh.positions.subarray(3 * v, 3 * v + 3));
      const off = Math.hypot(x - from[0], y - from[1]);
      const merit = z - (0.05 * this.camera.radius * off) / NEAR;
      if (off < NEAR && merit > highest) [best, highest] = [v, merit];
    }
    return best < 0 ? null : { number, vertex: best };
  }

  layer(panel) {
    return panel.layers[Math.min(this.state.layer, panel.layers.length - 1)];
  }

  /** The value of a vertex at a key; null for none. */
  at(panel, key, vertex) {
    const layer = this.layer(panel), whole = layer.values[key * panel.count + vertex];
    return whole === NONE ? null : layer.least + layer.step * whole;
  }

  told({ number, vertex }) {
    const panel = this.panels[number], layer = this.layer(panel);
    const { first, second, share } = around(layer.times, this.player.share);
    const [a, b] = [this.at(panel, first, vertex), this.at(panel, second, vertex)];
    const text = a === null || b === null ? "no value"
      : written(a + share * (b - a), digitsIn(layer.ends));
    return `vertex ${panel.mesh.ids[vertex]}: ${text}${layer.unit ? ` ${layer.unit}` : ""}`;
  }

  show(event) {
    const found = this.nearest(event), outer = this.stage.getBoundingClientRect();
    this.under = found;
    this.tip.hidden = !found;
    if (!found) return;
    this.tip.textContent = this.told(found);
    const left = Math.min(event.clientX - outer.left + 14, outer.width - this.tip.offsetWidth);
    this.tip.style.left = `${left}px`;
    this.tip.style.top = `${event.clientY - outer.top + 14}px`;
  }

  choose(found) {
    this.chosen = found;
    this.draw();
  }

  /** Draws the chosen vertex's values over time, a mark at now, and one where the vertex is. */
  draw() {
    if (!this.tip.hidden) this.tip.textContent = this.told(this.under);
    const found = this.chosen, panel = found && this.panels[found.number];
    this.plot.hidden = element("mark").hidden = !found;
    if (!found) return;
    element("of").textContent = this.told(found);
    const { times, ends } = this.layer(panel);
    const keys = times ? [...times.keys()] : [0];
    const values = keys.map((key) => this.at(panel, key, found.vertex));
    const known = values.filter((value) => value !== null);
    const low = Math.min(...known), span = Math.max(...known) - low || 1;
    const y = (value) => 46 - (42 * (value - low)) / span;
    const places = keys.flatMap((key, i) =>
      values[i] === null ? [] : [`${times ? 100 * times[key] : 0},${y(values[i])}`]);
    if (!times && known.length) places.push(`100,${y(known[0])}`);
    element("curve").setAttribute("points", places.join(" "));
    for (const name of ["x1", "x2"]) element("cursor").setAttribute(name, 100 * this.player.share);
    const labels = { most: Math.max(...known), least: low };
    for (const [name, value] of Object.entries(labels))
      element(name).textContent = known.length ? written(value, digitsIn(ends)) : "";
    this.mark(found, panel);
  }

  mark({ number, vertex }, panel) {
    const view = document.querySelectorAll(".view")[number].getBoundingClientRect();
    const outer = this.stage.getBoundingClientRect(), turn = this.camera.turned(number);
    const point = panel.mesh.positions.subarray(3 * vertex, 3 * vertex + 3);
    const [x, y] = this.camera.projected(turn, point), mark = element("mark");
    mark.style.left = `${(view.left + view.right) / 2 - outer.left + x}px`;
    mark.style.top = `${(view.top + view.bottom) / 2 - outer.top - y}px`;
  }
}
