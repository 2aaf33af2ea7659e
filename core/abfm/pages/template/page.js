// Wires the page: data, drawing, camera, player, colour bars, keyboard.

const element = (id) => document.getElementById(id);

/** A number with so many digits, short where it is huge or tiny. */
function written(value, digits = 3) {
  const rounded = Number(value.toPrecision(digits)), size = Math.abs(rounded);
  const isPlain = size === 0 || (1e-4 <= size && size < 10 ** Math.max(digits, 6));
  const text = isPlain ? String(rounded) : rounded.toExponential().replace("e+", "e");
  return text.replaceAll("-", "\u2212");
}

/** How many digits tell numbers of a range apart. */
function digitsIn([low, high]) {
  const beyond = Math.log10(Math.max(Math.abs(low), Math.abs(high)) / (high - low));
  return Math.min(3 + Math.max(Math.ceil(beyond), 0), 15) || 3;
}

function told(problem) {
  element("problem").textContent = problem;
  element("problem").hidden = false;
  element("stage").hidden = element("controls").hidden = true;
  document.body.classList.add("failed");
}

async function main() {
  const page = JSON.parse(element("page").textContent);
  if (!("DecompressionStream" in window)) {
    told("This browser is too old for this page: it needs one of 2023 or later.");
    return;
  }
  const data = await inflated(element("data")), canvas = element("canvas");
  let drawing;
  try {
    drawing = new Drawing(canvas, page, data);
  } catch (error) {
    told(`The surfaces cannot be drawn here: ${error.message}. Allow hardware acceleration, or ` +
      "open the page in another browser; it needs WebGL2.");
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

  let isAsked = false;
  function draw() {
    isAsked = false;
    drawing.draw(boxes(camera.density), camera, { ...state, share: player.share });
    values.draw();
    document.body.dataset.drawn = String(state.time);
  }
  function ask() {
    if (!isAsked) requestAnimationFrame(draw);
    isAsked = true;
  }

  function arrange() {
    camera.density = Math.min(window.devicePixelRatio || 1, 2);
    const grid = element("panels"), { width, height } = grid.getBoundingClientRect();
    grid.style.gridTemplateColumns = `repeat(${columns(camera.extents, width, height)}, 1fr)`;
    const outer = canvas.getBoundingClientRect();
    canvas.width = Math.round(outer.width * camera.density);
    canvas.height = Math.round(outer.height * camera.density);
    camera.fit(boxes());
    ask();
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
    ask();
  });
  follow(element("stage"), camera, panelAt, ask);
  const values = new Values(drawing.panels, camera, state, player, panelAt);
  choices(page, state, () => {
    bars(page, state.layer);
    arrange();
  });
  keyboard(player, camera, ask);
  const up = element("up");
  up.addEventListener("change", () => {
    camera.upright(up.value === "" ? null : Number(up.value));
    arrange();
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    drawing = new Drawing(canvas, page, data);
    ask();
  });
  new ResizeObserver(arrange).observe(element("stage"));
  bars(page, state.layer);
  arrange();
}

/** How many panels side by side make the surfaces largest. */
function columns(extents, width, height) {
  const across = Math.max(...extents.map(([x]) => x)), up = Math.max(...extents.map(([, y]) => y));
  const sizes = extents.map((_, i) => {
    const count = i + 1, rows = Math.ceil(extents.length / count);
    return Math.min(width / count / across, (height / rows - 28) / up);
  });
  return sizes.indexOf(Math.max(...sizes)) + 1;
}

/** Shows what the colours mean: each range once, with the panels that it is of. */
function bars(page, layer) {
  const seen = new Map();
  for (const panel of page.panels) {
    const own = panel.layers[Math.min(layer, panel.layers.length - 1)];
    const key = JSON.stringify([own.colormap, own.ends, own.unit]);
    if (!seen.has(key)) seen.set(key, { own, titles: [] });
    seen.get(key).titles.push(panel.title);
  }
  const box = element("bars");
  box.replaceChildren();
  for (const { own, titles } of [...seen.values()].filter(({ own }) => own.name)) {
    const add = (kind, text = "") => {
      const made = bar.appendChild(document.createElement("span"));
      made.className = kind;
      made.textContent = text;
      return made;
    };
    const bar = box.appendChild(document.createElement("div"));
    bar.className = "bar";
    const whose = seen.size > 1 ? `${titles.join(", ")}: ` : "";
    const what = add("what", `${whose}${own.name}${own.unit ? `, ${own.unit}` : ""}`);
    what.title = what.textContent;
    const [low, high] = own.ends;
    add("strip").style.backgroundImage =
      `linear-gradient(to right, ${page.gradients[own.colormap].join(", ")})`;
    for (const value of [low, low / 2 + high / 2, high])
      add("end", written(value, digitsIn(own.ends)));
  }
}

/** Lets one choose what the colours show, and hide what is drawn on the surfaces. */
function choices(page, state, changed) {
  const names = page.panels.map(({ layers }) => layers.map(({ name }) => name));
  const most = names.reduce((a, b) => (b.length > a.length ? b : a));
  const select = element("layer");
  select.hidden = most.length < 2;
  for (const name of most) select.add(new Option(name));
  select.addEventListener("change", () => {
    state.layer = select.selectedIndex;
    changed();
  });
  const ways = new Map(page.panels.flatMap(({ ways }) => ways.map((way) => [way.name, way])));
  for (const way of ways.values()) {
    const label = element("ways").appendChild(document.createElement("label"));
    const box = label.appendChild(document.createElement("input"));
    box.type = "checkbox";
    box.checked = way.shown;
    if (!way.shown) state.hidden.add(way.name);
    const dot = label.appendChild(document.createElement("i"));
    dot.style.background = `rgb(${way.color.map((c) => Math.round(255 * c)).join(" ")})`;
    label.append(way.name);
    box.addEventListener("change", () => {
      if (box.checked) state.hidden.delete(way.name);
      else state.hidden.add(way.name);
      changed();
    });
  }
}

function keyboard(player, camera, ask) {
  const turn = (x, y) => () => camera.turn(x, y, 24);
  const keys = {
    " ": () => player.toggle(),
    ArrowLeft: () => player.step(-1), ArrowRight: () => player.step(1),
    Home: () => player.go(player.clock.start), End: () => player.go(player.clock.end),
    l: () => player.loop(), r: () => camera.reset(),
    "+": () => camera.nearer(1.2), "=": () => camera.nearer(1.2), "-": () => camera.nearer(1 / 1.2),
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
    ask();
  });
}

main();
