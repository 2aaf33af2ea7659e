// Setup of the page: data, drawing, camera, player, colour bars and keyboard.

const element = (id) => document.getElementById(id);

/** Text of a number with significant digits, in scientific notation if huge or tiny. */
function formatNumber(value, digits = 3) {
  const rounded = Number(value.toPrecision(digits)), size = Math.abs(rounded);
  const isPlain = size === 0 || (1e-4 <= size && size < 10 ** Math.max(digits, 6));
  const text = isPlain ? String(rounded) : rounded.toExponential().replace("e+", "e");
  return text.replaceAll("-", "\u2212");
}

/** Number of digits that distinguish the numbers of a range. */
function digitsFor([low, high]) {
  const extraDigits = Math.log10(Math.max(Math.abs(low), Math.abs(high)) / (high - low));
  return Math.min(3 + Math.max(Math.ceil(extraDigits), 0), 15) || 3;
}

function showProblem(problem) {
  element("problem").textContent = problem;
  element("problem").hidden = false;
  element("stage").hidden = element("controls").hidden = true;
  document.body.classList.add("failed");
}

async function main() {
  const page = JSON.parse(element("page").textContent);
  if (!("DecompressionStream" in window)) {
    showProblem("This browser is too old for this page. Use a browser of 2023 or later.");
    return;
  }
  const data = await inflated(element("data")), canvas = element("canvas");
  let drawing;
  try {
    drawing = new Drawing(canvas, page, data);
  } catch (error) {
    showProblem(`The surfaces cannot be drawn: ${error.message}. The page needs WebGL2. Enable ` +
      "hardware acceleration, or open the page in another browser.");
    return;
  }
  const camera = new Camera(drawing.panels), state = { time: 0, layer: 0, hidden: new Set() };
  const views = [...document.querySelectorAll(".view")];
  const boxes = (density = 1) => {
    const outer = canvas.getBoundingClientRect();
    return views.map((view) => {
      const box = view.getBoundingClientRect();
      return [box.left - outer.left, outer.bottom - box.bottom, box.width, box.height].map((x) =>
        Math.round(x * density));
    });
  };

  let isRequested = false;
  function draw() {
    isRequested = false;
    drawing.draw(boxes(camera.density), camera, { ...state, share: player.share });
    values.draw();
    document.body.dataset.drawn = String(state.time);
  }
  function requestDraw() {
    if (!isRequested) requestAnimationFrame(draw);
    isRequested = true;
  }

  function arrange() {
    camera.density = Math.min(window.devicePixelRatio || 1, 2);
    const grid = element("panels"), { width, height } = grid.getBoundingClientRect();
    grid.style.gridTemplateColumns = `repeat(${columns(camera.extents, width, height)}, 1fr)`;
    const outer = canvas.getBoundingClientRect();
    canvas.width = Math.round(outer.width * camera.density);
    canvas.height = Math.round(outer.height * camera.density);
    camera.fit(boxes());
    requestDraw();
  }

  const panelAt = (x, y) => {
    const found = views.findIndex((view) => {
      const { left, right, top, bottom } = view.getBoundingClientRect();
      return left <= x && x < right && top <= y && y < bottom;
    });
    const box = views[Math.max(found, 0)].getBoundingClientRect();
    const from = [x - (box.left + box.right) / 2, (box.top + box.bottom) / 2 - y];
    return { number: found, size: Math.min(box.width, box.height), from };
  };

  const player = new Player(page.clock, (time) => {
    state.time = time;
    requestDraw();
  });
  followPointers(element("stage"), camera, panelAt, requestDraw);
  const values = new Values(drawing.panels, camera, state, player, panelAt);
  addControls(page, state, () => {
    drawColorBars(page, state.layer);
    arrange();
  });
  keyboard(player, camera, requestDraw);
  const up = element("up");
  up.addEventListener("change", () => {
    camera.setUpAxis(up.value === "" ? null : Number(up.value));
    arrange();
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    drawing = new Drawing(canvas, page, data);
    requestDraw();
  });
  new ResizeObserver(arrange).observe(element("stage"));
  drawColorBars(page, state.layer);
  arrange();
}

/** Number of columns of panels for which the surfaces are largest. */
function columns(extents, width, height) {
  const across = Math.max(...extents.map(([x]) => x)), up = Math.max(...extents.map(([, y]) => y));
  const sizes = extents.map((_, i) => {
    const count = i + 1, rows = Math.ceil(extents.length / count);
    return Math.min(width / count / across, (height / rows - 28) / up);
  });
  return sizes.indexOf(Math.max(...sizes)) + 1;
}

/** Draws colour bars: each range once, with the titles of its panels. */
function drawColorBars(page, layer) {
  const ranges = new Map();
  for (const panel of page.panels) {
    const shown = panel.layers[Math.min(layer, panel.layers.length - 1)];
    const key = JSON.stringify([shown.colormap, shown.ends, shown.unit]);
    if (!ranges.has(key)) ranges.set(key, { shown, titles: [] });
    ranges.get(key).titles.push(panel.title);
  }
  const box = element("bars");
  box.replaceChildren();
  for (const { shown, titles } of [...ranges.values()].filter((each) => each.shown.name)) {
    const add = (kind, text = "") => {
      const part = bar.appendChild(document.createElement("span"));
      part.className = kind;
      part.textContent = text;
      return part;
    };
    const bar = box.appendChild(document.createElement("div"));
    bar.className = "bar";
    const panels = ranges.size > 1 ? `${titles.join(", ")}: ` : "";
    const unit = shown.unit ? `, ${shown.unit}` : "";
    const label = add("label", `${panels}${shown.name}${unit}`);
    label.title = label.textContent;
    const [low, high] = shown.ends;
    const [below, above] = shown.clipped;
    const strip = add(`strip${below ? " clips-low" : ""}${above ? " clips-high" : ""}`);
    strip.style.backgroundImage = shown.gradient;
    const text = (value) => formatNumber(value, digitsFor(shown.ends));
    if (below || above) strip.title = `Values range from ${shown.full.map(text).join(" to ")}.`;
    bar.style.minWidth = `${4.8 * Math.max(shown.ticks.length, 3)}rem`;
    for (const value of shown.ticks)
      add("end", text(value)).style.left = `${(100 * (value - low)) / (high - low)}%`;
  }
}

/** Adds controls that choose the layer, and show or hide paths on the surfaces. */
function addControls(page, state, changed) {
  const names = page.panels.map(({ layers }) => layers.map(({ name }) => name));
  const options = names.reduce((a, b) => (b.length > a.length ? b : a));
  const select = element("layer");
  select.hidden = options.length < 2;
  for (const name of options) select.add(new Option(name));
  select.addEventListener("change", () => {
    state.layer = select.selectedIndex;
    changed();
  });
  const paths = new Map(page.panels.flatMap(({ paths }) => paths.map((path) => [path.name, path])));
  for (const path of paths.values()) {
    const label = element("paths").appendChild(document.createElement("label"));
    const box = label.appendChild(document.createElement("input"));
    box.type = "checkbox";
    box.checked = path.shown;
    if (!path.shown) state.hidden.add(path.name);
    const dot = label.appendChild(document.createElement("i"));
    dot.style.background = `rgb(${path.color.map((c) => Math.round(255 * c)).join(" ")})`;
    label.append(path.name);
    box.addEventListener("change", () => {
      if (box.checked) state.hidden.delete(path.name);
      else state.hidden.add(path.name);
      changed();
    });
  }
}

function keyboard(player, camera, requestDraw) {
  const turn = (x, y) => () => camera.turn(x, y, 24);
  const keys = {
    " ": () => player.toggle(),
    ArrowLeft: () => player.step(-1), ArrowRight: () => player.step(1),
    Home: () => player.setTime(player.clock.start), End: () => player.setTime(player.clock.end),
    l: () => player.loop(), r: () => camera.reset(),
    "+": () => camera.zoomBy(1.2), "=": () => camera.zoomBy(1.2), "-": () => camera.zoomBy(1 / 1.2),
  };
  const turns = {
    ArrowLeft: turn(-1, 0), ArrowRight: turn(1, 0), ArrowUp: turn(0, -1), ArrowDown: turn(0, 1),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    if (event.key === " " && event.target.matches("button, input[type=checkbox]")) return;
    const act = event.shiftKey && turns[event.key] ? turns[event.key] : keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
    requestDraw();
  });
}

main();
