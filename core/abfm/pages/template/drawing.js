// WebGL2 drawing of surfaces, with values interpolated between two keys, and of moving objects.

const SURFACE = {
  vertex: `
    uniform mat3 turn; uniform vec2 scale, pan; uniform float distance, radius;
    uniform float share, low, high, none;
    layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal;
    layout(location = 2) in vec2 keys;
    out vec3 facing; out float place; out float known;
    vec4 project(vec3 point, float nearer) {
      vec3 eye = turn * point;
      float w = distance - eye.z, near = distance - radius, far = distance + radius;
      float depth = ((far + near) * w - 2.0 * far * near) / (far - near) - nearer * w;
      return vec4(eye.xy * scale * distance + pan * w, depth, w);
    }
    void main() {
      known = keys.x == none || keys.y == none ? 0.0 : 1.0;
      place = known * (mix(keys.x, keys.y, share) - low) / (high - low);
      facing = turn * normal;
      gl_Position = project(position, 0.0);
    }`,
  // lighting of the app's surfaces, computed in linear light from the colours of the colour bar
  fragment: `
    uniform sampler2D colors;
    in vec3 facing; in float place; in float known; out vec4 color;
    void main() {
      vec3 normal = normalize(facing + vec3(0.0, 0.0, 1e-20));
      if (!gl_FrontFacing) normal = -normal;
      float wrapped = 0.5 + 0.5 * dot(normal, vec3(-0.35, 0.55, 0.76));
      float light = (0.35 + 0.65 * wrapped) * (0.75 + 0.25 * max(normal.z, 0.0));
      // next to vertices without a value, known values extend to the centre of the edge
      float value = clamp(place / max(known, 1e-6), 0.0, 1.0);
      vec3 base = texture(colors, vec2((value * 255.0 + 0.5) / 256.0, 0.5)).rgb;
      if (known < 0.5) base = vec3(0.55);
      vec3 lit = base * light;
      color = vec4(mix(12.92 * lit, 1.055 * pow(lit, vec3(1.0 / 2.4)) - 0.055,
        step(0.0031308, lit)), 1.0);
    }`,
};

// A piece of a path between two points and two times: a line that grows and fades, with round
// joints; or a disc that moves along it; or an arrow that is visible between the times.
const [LINE, DISC, ARROW] = [0, 1, 2];
const ATTRIBUTES = [3, 3, 2, 3, 1], PIECE_NUMBERS = 12; // numbers of each attribute, and their sum
const PATH = {
  vertex: `
    uniform mat3 turn; uniform vec2 scale, pan, pixel; uniform float distance, radius;
    uniform float now, tail, width; uniform int kind;
    layout(location = 0) in vec3 start; layout(location = 1) in vec3 end;
    layout(location = 2) in vec2 times; layout(location = 3) in vec3 normal;
    layout(location = 4) in float weight;
    out vec2 spot; out float age; flat out float len, strength;
    vec4 project(vec3 point) {
      vec3 eye = turn * point;
      float w = distance - eye.z, near = distance - radius, far = distance + radius;
      float depth = ((far + near) * w - 2.0 * far * near) / (far - near) - (kind == 1 ? 0.03 : 0.012) * w;
      return vec4(eye.xy * scale * distance + pan * w, depth, w);
    }
    void main() {
      vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
      float span = max(times.y - times.x, 1e-9);
      float first = clamp((now - tail - times.x) / span, 0.0, 1.0);
      float last = clamp((now - times.x) / span, 0.0, 1.0);
      bool isPresent = times.x <= now && now <= times.y;
      bool isShown = kind == 0 ? last > first : isPresent;
      if (kind == 1) first = last;
      if (kind == 2) {
        first = 0.0;
        last = 1.0;
        // hide arrows that the outline of the surface would cut
        isShown = isPresent && (now < times.y || times.y >= 1.0) && abs((turn * normal).z) > 0.3;
      }
      vec4 one = project(mix(start, end, first)), other = project(mix(start, end, last));
      vec2 along = (other.xy / other.w - one.xy / one.w) / pixel;
      len = length(along);
      along = len > 1e-6 ? along / len : vec2(1.0, 0.0);
      float reach = 1.0 + width * (kind == 0 ? 0.5 : kind == 1 ? 1.0 : 2.2);
      spot = corner * reach + vec2(corner.x < 0.0 ? 0.0 : len, 0.0);
      vec4 place = corner.x < 0.0 ? one : other;
      place.xy += (along * corner.x + vec2(-along.y, along.x) * corner.y) * reach * pixel * place.w;
      strength = weight;
      age = kind == 0 ? (now - times.x - mix(first, last, 0.5 + 0.5 * corner.x) * span) / tail : 0.0;
      gl_Position = isShown ? place : vec4(0.0, 0.0, 2.0, 1.0);
    }`,
  // `off` is the signed distance of a pixel from the shape
  fragment: `
    uniform vec3 ink; uniform int kind; uniform float width, opacity;
    in vec2 spot; in float age; flat in float len, strength; out vec4 color;
    void main() {
      float off = length(vec2(spot.x - clamp(spot.x, 0.0, len), spot.y)), rim = 0.0;
      if (kind == 0) off -= 0.5 * width;
      else if (kind == 1) {
        off -= width;
        rim = -min(1.6, 0.3 * width);
      } else {
        float shaft_width = min(width, 0.16 * len), head = min(4.5 * shaft_width, 0.6 * len);
        float half_width = 0.45 * head, side = abs(spot.y);
        float shaft = max(max(side - 0.5 * shaft_width, -spot.x), spot.x - len + 0.5 * head);
        float tip = dot(vec2(spot.x - len, side), normalize(vec2(half_width, head)));
        off = min(shaft, max(len - head - spot.x, tip)) - 1.0;
        rim = -1.0;
      }
      vec3 mixed = mix(ink, vec3(1.0), rim < 0.0 ? clamp(off - rim + 0.5, 0.0, 1.0) : 0.0);
      color = vec4(mixed, clamp(0.5 - off, 0.0, 1.0) * opacity * strength * clamp(1.0 - age, 0.0, 1.0));
      if (color.a < 0.01) discard;
    }`,
};

class Drawing {
  /** Creates all buffers; throws an error if the browser has no WebGL2. */
  constructor(canvas, page, data) {
    const gl = canvas.getContext("webgl2", {
      alpha: false, antialias: true, preserveDrawingBuffer: true,
    });
    if (!gl) throw new Error("WebGL2 is not available");
    this.gl = gl;
    this.surface = this.program(SURFACE);
    this.path = this.program(PATH);
    this.meshes = page.meshes.map((mesh) => this.mesh(mesh, data));
    this.colormaps = page.colormaps.map((map) => this.colormap(unpacked(data, map)));
    this.panels = page.panels.map((panel) => this.panel(panel, data));
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(1, 1, 1, 1);
  }

  program({ vertex, fragment }) {
    const gl = this.gl, built = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float; precision highp int;" + text);
      gl.compileShader(shader);
      gl.attachShader(built, shader);
    }
    gl.linkProgram(built);
    if (!gl.getProgramParameter(built, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(`WebGL2 cannot compile a shader: ${gl.getProgramInfoLog(built)}`);
    const locations = {}, count = gl.getProgramParameter(built, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const { name } = gl.getActiveUniform(built, i);
      locations[name] = gl.getUniformLocation(built, name);
    }
    return { built, locations };
  }

  buffer(values, target = this.gl.ARRAY_BUFFER) {
    const built = this.gl.createBuffer();
    this.gl.bindBuffer(target, built);
    this.gl.bufferData(target, values, this.gl.STATIC_DRAW);
    return built;
  }

  mesh(mesh, data) {
    const quantized = unpacked(data, mesh.positions), faces = unpacked(data, mesh.faces);
    const positions = Float32Array.from(quantized, (q, i) => mesh.low[i % 3] + mesh.step[i % 3] * q);
    return {
      positions, faces, ids: unpacked(data, mesh.ids), culls: mesh.culls,
      buffers: [this.buffer(positions), this.buffer(normals(positions, faces))],
    };
  }

  colormap(bytes) {
    const gl = this.gl, built = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, built);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    for (const name of ["MIN_FILTER", "MAG_FILTER"])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    return built;
  }

  panel(panel, data) {
    const gl = this.gl, mesh = this.meshes[panel.mesh], array = gl.createVertexArray();
    const count = mesh.positions.length / 3;
    gl.bindVertexArray(array);
    mesh.buffers.forEach((buffer, place) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    });
    const keys = new Uint16Array(2 * count), buffer = this.buffer(keys);
    gl.enableVertexAttribArray(2);
    gl.vertexAttribPointer(2, 2, gl.UNSIGNED_SHORT, false, 0, 0);
    this.buffer(mesh.faces, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    const layers = panel.layers.map((layer) => ({
      ...layer, values: unpacked(data, layer.values),
      times: layer.times ? unpackedFloats(data, layer.times) : null,
    }));
    const paths = panel.paths.map((path) => this.paths(path, data));
    return { mesh, array, keys, buffer, count, layers, paths, axes: panel.axes, loaded: null };
  }

  paths(path, data) {
    const gl = this.gl, array = gl.createVertexArray(), pieces = unpackedFloats(data, path.pieces);
    gl.bindVertexArray(array);
    const buffer = this.buffer(pieces), count = pieces.length / PIECE_NUMBERS;
    for (const place of ATTRIBUTES.keys()) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribDivisor(place, 1);
    }
    gl.bindVertexArray(null);
    const [starts, ends] = [6, 7].map((at) =>
      Float32Array.from({ length: count }, (_, i) => pieces[PIECE_NUMBERS * i + at]));
    return { ...path, array, buffer, count, starts, ends };
  }

  /** Draws the pieces that are visible at a time; pieces are sorted by their start times. */
  drawPieces({ array, buffer, count, starts, ends }, time, tail) {
    const gl = this.gl, now = Math.fround(time); // single precision, as on the graphics card
    const first = ends.findIndex((end) => end + tail >= now);
    const after = starts.findIndex((start) => start > now), last = after < 0 ? count : after;
    if (first < 0 || last <= first) return;
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    let offset = 4 * PIECE_NUMBERS * first;
    ATTRIBUTES.forEach((size, place) => {
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 4 * PIECE_NUMBERS, offset);
      offset += 4 * size;
    });
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, last - first);
  }

  /** Loads the two keys around a time, and returns the weight of the second one. */
  loadKeys(panel, layer, time) {
    const { first, second, share } = around(layer.times, time);
    const { loaded } = panel;
    if (!loaded || loaded.layer !== layer || loaded.first !== first) {
      const { keys, count } = panel, values = layer.values;
      for (let i = 0; i < count; i++) {
        keys[2 * i] = values[first * count + i];
        keys[2 * i + 1] = values[second * count + i];
      }
      this.gl.bindBuffer(this.gl.ARRAY_BUFFER, panel.buffer);
      this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, keys);
      panel.loaded = { layer, first };
    }
    return share;
  }

  /** Draws each panel in its box, [x, y, width, height] in pixels from the lower left corner. */
  draw(boxes, camera, state) {
    const gl = this.gl;
    gl.disable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    this.panels.forEach((panel, number) => {
      const box = boxes[number];
      if (box[2] < 1 || box[3] < 1) return;
      gl.viewport(...box);
      gl.scissor(...box);
      this.drawSurface(panel, number, box, camera, state);
      this.drawPaths(panel, number, box, camera, state);
    });
  }

  setCamera({ locations }, number, box, camera) {
    const gl = this.gl, { scale, pan } = camera.projection(box);
    gl.uniformMatrix3fv(locations.turn, true, camera.rotationOf(number));
    gl.uniform2fv(locations.scale, scale);
    gl.uniform2fv(locations.pan, pan);
    gl.uniform1f(locations.distance, camera.distance);
    gl.uniform1f(locations.radius, camera.radius);
  }

  drawSurface(panel, number, box, camera, { share: now, layer: chosen }) {
    const gl = this.gl, { built, locations } = this.surface;
    const layer = panel.layers[Math.min(chosen, panel.layers.length - 1)];
    const share = this.loadKeys(panel, layer, now);
    gl.useProgram(built);
    this.setCamera(this.surface, number, box, camera);
    gl.uniform1f(locations.share, share);
    gl.uniform1f(locations.low, layer.low);
    gl.uniform1f(locations.high, layer.high);
    gl.uniform1f(locations.none, NONE);
    gl.bindTexture(gl.TEXTURE_2D, this.colormaps[layer.colormap]);
    if (panel.mesh.culls) gl.enable(gl.CULL_FACE);
    gl.bindVertexArray(panel.array);
    gl.drawElements(gl.TRIANGLES, panel.mesh.faces.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
  }

  drawPaths(panel, number, box, camera, { share, hidden }) {
    const gl = this.gl, { built, locations } = this.path;
    const shown = panel.paths.filter((path) => path.count && !hidden.has(path.name));
    if (!shown.length) return;
    gl.useProgram(built);
    this.setCamera(this.path, number, box, camera);
    gl.uniform2f(locations.pixel, 2 / box[2], 2 / box[3]);
    gl.uniform1f(locations.now, share);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const kind of [LINE, ARROW, DISC])
      for (const path of shown) {
        const width = [path.line, path.disc, path.arrow][kind];
        if (!width) continue;
        gl.uniform1i(locations.kind, kind);
        gl.uniform1f(locations.width, width * camera.density);
        gl.uniform1f(locations.tail, path.tail);
        gl.uniform1f(locations.opacity, path.opacity);
        gl.uniform3fv(locations.ink, path.color);
        this.drawPieces(path, share, kind === LINE ? path.tail : 0);
      }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }
}

const NONE = 65535; // represents an unknown value

/** The two keys around a time, by bisection, and the weight of the second one. */
function around(times, time) {
  if (!times || times.length < 2) return { first: 0, second: 0, share: 0 };
  let first = 0, last = times.length - 1;
  while (last - first > 1) {
    const middle = (first + last) >> 1;
    if (times[middle] <= time) first = middle;
    else last = middle;
  }
  const share = (time - times[first]) / (times[last] - times[first]);
  return { first, second: last, share: Math.min(Math.max(share, 0), 1) };
}

/** Normals of vertices, averaged over adjacent faces with weights by area. */
function normals(positions, faces) {
  const found = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [i, j, k] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const ux = positions[j] - positions[i], vx = positions[k] - positions[i];
    const uy = positions[j + 1] - positions[i + 1], vy = positions[k + 1] - positions[i + 1];
    const uz = positions[j + 2] - positions[i + 2], vz = positions[k + 2] - positions[i + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const v of [i, j, k]) {
      found[v] += x;
      found[v + 1] += y;
      found[v + 2] += z;
    }
  }
  return found;
}
