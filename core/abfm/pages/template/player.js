// Time: playing, pausing, looping and stepping, and the time bar.

const REST_SECONDS = 0.6; // duration of the end before a loop restarts
const TICKS_MAX = 120;
const FRAME_SECONDS_MAX = 0.5; // longest step, for example after the tab was hidden

class Player {
  /** Calls `changed` with every new time. */
  constructor(clock, changed) {
    Object.assign(this, { clock, changed, time: clock.first, playing: false, loops: true });
    this.speed = 1;
    this.restSeconds = 0;
    this.bar = document.getElementById("time");
    this.bar.addEventListener("input", () => {
      this.pause();
      this.setTime(clock.start + this.bar.valueAsNumber * (clock.end - clock.start));
    });
    this.button = document.getElementById("play");
    this.button.addEventListener("click", () => this.toggle());
    const loop = document.getElementById("loop");
    loop.addEventListener("click", () => this.loop());
    const speed = document.getElementById("speed");
    speed.addEventListener("change", () => (this.speed = Number(speed.value)));
    this.drawTicks();
    this.setTime(this.time);
  }

  /** Relative time from start to end, 0 to 1; times of keys and paths are also relative. */
  get share() {
    const { start, end } = this.clock;
    return (this.time - start) / (end - start);
  }

  /** Draws ticks at frames, and spans of times with their texts. */
  drawTicks() {
    const { start, end, ticks, spans } = this.clock, box = document.getElementById("ticks");
    const share = (time) => `${(100 * (time - start)) / (end - start)}%`;
    const every = Math.ceil(ticks.length / TICKS_MAX);
    for (const time of ticks.filter((_, number) => number % every === 0)) {
      const tick = box.appendChild(document.createElement("i"));
      tick.style.left = share(time);
    }
    for (const span of spans) {
      const part = box.appendChild(document.createElement("b"));
      part.className = span.tone;
      part.style.left = share(span.start);
      part.style.width = `calc(${share(start + span.end - span.start)} - 1px)`;
      part.title = span.text;
    }
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    const { start, end } = this.clock;
    if (this.time >= end) this.setTime(start);
    this.playing = true;
    this.show();
    let before = null;
    const next = (now) => {
      if (!this.playing) return;
      const passed = before === null ? 0 : Math.min((now - before) / 1000, FRAME_SECONDS_MAX);
      before = now;
      this.advance(passed);
      requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }

  advance(seconds) {
    const { start, end } = this.clock;
    if (this.time < end) {
      this.restSeconds = 0;
      this.setTime(this.time + (seconds * this.speed * (end - start)) / this.clock.seconds);
    } else if (!this.loops) this.pause();
    else if ((this.restSeconds += seconds) >= REST_SECONDS) this.setTime(start);
  }

  pause() {
    this.playing = false;
    this.show();
  }

  loop() {
    this.loops = !this.loops;
    this.show();
  }

  show() {
    document.body.classList.toggle("playing", this.playing);
    this.button.setAttribute("aria-label", this.playing ? "Pause" : "Play");
    document.getElementById("loop").setAttribute("aria-pressed", String(this.loops));
  }

  /** Sets the time, limited to the range of the clock. */
  setTime(time) {
    const { start, end, unit, spans } = this.clock;
    this.time = Math.min(Math.max(time, start), end);
    this.bar.valueAsNumber = this.share;
    const digits = Math.max(Math.ceil(-Math.log10((end - start) / 60)), 0);
    const number = digits > 6 ? formatNumber(this.time, digitsFor([start, end]))
      : this.time.toFixed(digits).replace("-", "\u2212");
    const text = `${number}${unit ? ` ${unit}` : ""}`;
    this.bar.setAttribute("aria-valuetext", text);
    document.getElementById("now").textContent = text;
    const here = spans.find((span) => span.start <= this.time && this.time <= span.end);
    document.getElementById("span").textContent = here ? here.text : "";
    this.changed(this.time);
  }

  /** Goes to the next or the previous tick. */
  step(direction) {
    const { start, end, ticks } = this.clock, tolerance = 1e-6 * (end - start);
    this.pause();
    const candidates = ticks.filter((tick) => (tick - this.time) * direction > tolerance);
    const next = direction > 0 ? Math.min(...candidates) : Math.max(...candidates);
    this.setTime(Number.isFinite(next) ? next : direction > 0 ? end : start);
  }
}
