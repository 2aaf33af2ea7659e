// Time: plays, pauses, loops, steps; the bar that shows and sets it.

const REST = 0.6; // seconds that the end is shown before it begins again
const MOST_TICKS = 120;
const LONGEST = 0.5; // seconds that count where the browser drew nothing, as in a hidden tab

class Player {
  /** `changed` is called with every new time. */
  constructor(clock, changed) {
    Object.assign(this, { clock, changed, time: clock.first, playing: false, loops: true });
    this.speed = 1;
    this.rested = 0;
    this.bar = document.getElementById("time");
    this.bar.addEventListener("input", () => {
      this.pause();
      this.go(clock.start + this.bar.valueAsNumber * (clock.end - clock.start));
    });
    this.button = document.getElementById("play");
    this.button.addEventListener("click", () => this.toggle());
    const loop = document.getElementById("loop");
    loop.addEventListener("click", () => this.loop());
    const speed = document.getElementById("speed");
    speed.addEventListener("change", () => (this.speed = Number(speed.value)));
    this.marks();
    this.go(this.time);
  }

  /** How far the time is from the start to the end, 0 to 1: of the keys and ways, all times. */
  get share() {
    const { start, end } = this.clock;
    return (this.time - start) / (end - start);
  }

  /** Draws ticks at frames, and what is said of the times between them. */
  marks() {
    const { start, end, ticks, spans } = this.clock, box = document.getElementById("ticks");
    const share = (time) => `${(100 * (time - start)) / (end - start)}%`;
    const every = Math.ceil(ticks.length / MOST_TICKS);
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
    if (this.time >= end) this.go(start);
    this.playing = true;
    this.show();
    let before = null;
    const next = (now) => {
      if (!this.playing) return;
      const passed = before === null ? 0 : Math.min((now - before) / 1000, LONGEST);
      before = now;
      this.advance(passed);
      requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }

  advance(seconds) {
    const { start, end } = this.clock;
    if (this.time < end) {
      this.rested = 0;
      this.go(this.time + (seconds * this.speed * (end - start)) / this.clock.seconds);
    } else if (!this.loops) this.pause();
    else if ((this.rested += seconds) >= REST) this.go(start);
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

  /** Goes to a time, as near as there is one. */
  go(time) {
    const { start, end, unit, spans } = this.clock;
    this.time = Math.min(Math.max(time, start), end);
    this.bar.valueAsNumber = this.share;
    const digits = Math.max(Math.ceil(-Math.log10((end - start) / 60)), 0);
    const number = digits > 6 ? written(this.time, digitsIn([start, end]))
      : this.time.toFixed(digits).replace("-", "\u2212");
    const told = `${number}${unit ? ` ${unit}` : ""}`;
    this.bar.setAttribute("aria-valuetext", told);
    document.getElementById("now").textContent = told;
    const here = spans.find((span) => span.start <= this.time && this.time <= span.end);
    document.getElementById("span").textContent = here ? here.text : "";
    this.changed(this.time);
  }

  /** Goes to the next tick, or the one before. */
  step(direction) {
    const { start, end, ticks } = this.clock, least = 1e-6 * (end - start);
    this.pause();
    const beyond = ticks.filter((tick) => (tick - this.time) * direction > least);
    const next = direction > 0 ? Math.min(...beyond) : Math.max(...beyond);
    this.go(Number.isFinite(next) ? next : direction > 0 ? end : start);
  }
}
