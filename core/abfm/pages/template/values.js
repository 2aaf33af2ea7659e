// The value under the mouse, and a plot over time of the value of a clicked vertex.

const PICK_PIXELS = 10; // maximum distance of a vertex from the mouse
const CLICK_PIXELS = 4; // maximum movement of a click

class Values {
  constructor(panels, camera, state, player, panelAt) {
    Object.assign(this, { panels, camera, state, player, panelAt });
    this.under = this.chosen = null; // vertex under the mouse, and clicked vertex
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
      if (event.button === 0 && moved <= CLICK_PIXELS) this.choose(this.nearest(event));
    });
  }

  /** The closest visible vertex at the mouse, and its panel; null if there is none. */
  nearest({ clientX, clientY }) {
    const { number, from } = this.panelAt(clientX, clientY);
    if (number < 0) return null;
    const { mesh, count } = this.panels[number], turn = this.camera.rotationOf(number);
    let best = -1, bestMerit = -Infinity;
    for (let v = 0; v < count; v++) {
      const [x, y, z] = this.camera.project(turn, mesh.positions.subarray(3 * v, 3 * v + 3));
      const off = Math.hypot(x - from[0], y - from[1]);
      const merit = z - (0.05 * this.camera.radius * off) / PICK_PIXELS;
      if (off < PICK_PIXELS && merit > bestMerit) [best, bestMerit] = [v, merit];
    }
    return best < 0 ? null : { number, vertex: best };
  }

  layer(panel) {
    return panel.layers[Math.min(this.state.layer, panel.layers.length - 1)];
  }

  /** Value of a vertex at a key; null if it is unknown. */
  at(panel, key, vertex) {
    const layer = this.layer(panel), number = layer.values[key * panel.count + vertex];
    return number === NONE ? null : layer.minimum + layer.step * number;
  }

  valueText({ number, vertex }) {
    const panel = this.panels[number], layer = this.layer(panel);
    const { first, second, share } = around(layer.times, this.player.share);
    const [a, b] = [this.at(panel, first, vertex), this.at(panel, second, vertex)];
    const text = a === null || b === null ? "no value"
      : formatNumber(a + share * (b - a), digitsFor(layer.ends));
    return `vertex ${panel.mesh.ids[vertex]}: ${text}${layer.unit ? ` ${layer.unit}` : ""}`;
  }

  show(event) {
    const found = this.nearest(event), outer = this.stage.getBoundingClientRect();
    this.under = found;
    this.tip.hidden = !found;
    if (!found) return;
    this.tip.textContent = this.valueText(found);
    const left = Math.min(event.clientX - outer.left + 14, outer.width - this.tip.offsetWidth);
    this.tip.style.left = `${left}px`;
    this.tip.style.top = `${event.clientY - outer.top + 14}px`;
  }

  choose(found) {
    this.chosen = found;
    this.draw();
  }

  /** Plots the values of the chosen vertex over time, and marks the current time and the vertex. */
  draw() {
    if (!this.tip.hidden) this.tip.textContent = this.valueText(this.under);
    const found = this.chosen, panel = found && this.panels[found.number];
    this.plot.hidden = element("marker").hidden = !found;
    if (!found) return;
    element("plot-title").textContent = this.valueText(found);
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
    const labels = { "plot-max": Math.max(...known), "plot-min": low };
    for (const [name, value] of Object.entries(labels))
      element(name).textContent = known.length ? formatNumber(value, digitsFor(ends)) : "";
    this.placeMarker(found, panel);
  }

  placeMarker({ number, vertex }, panel) {
    const view = document.querySelectorAll(".view")[number].getBoundingClientRect();
    const outer = this.stage.getBoundingClientRect(), turn = this.camera.rotationOf(number);
    const point = panel.mesh.positions.subarray(3 * vertex, 3 * vertex + 3);
    const [x, y] = this.camera.project(turn, point), marker = element("marker");
    marker.style.left = `${(view.left + view.right) / 2 - outer.left + x}px`;
    marker.style.top = `${(view.top + view.bottom) / 2 - outer.top - y}px`;
  }
}
