// What is rendered, as it is rendered: the last four seconds of acceleration, speed and force, their spectrogram and the level.

const SECONDS = 4;
const HIGHEST_HZ = 1000, LOWEST_HZ = 20; // of the spectrogram: what skin feels
const LOUDEST_DB = -24, RANGE_DB = 48;
const METER_DB = 60, COMPRESSED_DB = -1.9; // of full scale
const PERIOD = 128; // samples of a pair of peaks

export class Monitor {
  constructor({ traces, spectrogram, numbers, meter }) {
    Object.assign(this, { traces, spectrogram, numbers, meter });
    this.listen(48000, null, null);
    this.colours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.colours());
    for (const canvas of [traces, spectrogram]) new ResizeObserver(() => this.resize(canvas)).observe(canvas);
  }

  colours() {
    // A variable says `light-dark(…)`; an element that has it as its colour says which of the two.
    const probe = document.body.appendChild(document.createElement("i"));
    const of = (name) => ((probe.style.color = `var(${name})`), getComputedStyle(probe).color);
    this.ink = { acceleration: of("--ink"), speed: of("--speed"), force: of("--force"), line: of("--line") };
    const [from, to] = [of("--panel"), of("--accent")].map(channels);
    const pale = channels(of("--glow"));
    this.ramp = Array.from({ length: 256 }, (_, i) => {
      const share = i / 255, [a, b, t] = share < 0.6 ? [from, to, share / 0.6] : [to, pale, (share - 0.6) / 0.4];
      return a.map((value, c) => Math.round(value + t * (b[c] - value)));
    });
    probe.remove();
    this.blank();
    this.wake();
  }

  /** Draw what an analyser is given at a rate, and how loud what leaves is, of another. */
  listen(rate, analyser, output) {
    Object.assign(this, { rate, analyser, output, bins: null });
    this.clear();
  }

  clear() {
    const n = Math.ceil((SECONDS * this.rate) / PERIOD);
    this.peaks = new Float32Array(2 * n);
    this.conditions = []; // [frame, speed, force]
    this.frame = 0;
    this.largest = { acceleration: 1, speed: 100, force: 1 };
    this.quiet = 0;
  }

  resize(canvas) {
    const ratio = devicePixelRatio;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas === this.spectrogram) this.blank();
    this.wake();
  }

  blank() {
    const g = this.spectrogram.getContext("2d");
    g.fillStyle = `rgb(${this.ramp?.[0] ?? "0 0 0"})`;
    g.fillRect(0, 0, this.spectrogram.width, this.spectrogram.height);
    this.shown = this.frame;
  }

  /** Take in what the audio thread says, 62 times a second. */
  report({ peaks, rms, speed, force, n }) {
    const size = this.peaks.length / 2;
    for (let i = 0; i < peaks.length / 2; i++) {
      const at = (this.frame / PERIOD + i) % size;
      this.peaks[2 * at] = peaks[2 * i];
      this.peaks[2 * at + 1] = peaks[2 * i + 1];
    }
    this.frame += n;
    this.conditions.push([this.frame, speed, force]);
    while (this.conditions.length && this.conditions[0][0] < this.frame - SECONDS * this.rate) this.conditions.shift();
    this.latest = { rms, speed, force };
    this.quiet = rms > 1e-6 || speed > 0.1 ? 0 : this.quiet + n;
    if (this.quiet < (SECONDS + 1) * this.rate) this.wake(); // nothing is drawn that does not change
  }

  wake() {
    this.drawing ??= requestAnimationFrame(() => {
      this.drawing = null;
      this.draw();
    });
  }

  draw() {
    this.drawTraces();
    if (this.analyser) this.drawSpectrum();
    if (!this.latest) return;
    const { rms, speed, force } = this.latest;
    this.numbers.acceleration.value = rms < 100 ? rms.toFixed(rms < 10 ? 2 : 1) : rms.toFixed(0);
    this.numbers.speed.value = speed.toFixed(0);
    this.numbers.force.value = force.toFixed(2);
    this.drawMeter();
  }

  /** The peak of what leaves, falling 24 dB a second: red where it is compressed. */
  drawMeter() {
    if (!this.output) return;
    this.leaving ??= new Float32Array(this.output.fftSize);
    this.output.getFloatTimeDomainData(this.leaving);
    let peak = 0;
    for (const value of this.leaving) peak = Math.max(peak, Math.abs(value));
    const now = performance.now(), fallen = (this.peakDb ?? -METER_DB) - ((now - (this.metered ?? now)) / 1000) * 24;
    this.metered = now;
    this.peakDb = Math.max(-METER_DB, fallen, 20 * Math.log10(Math.max(1e-6, peak)));
    this.meter.style.transform = `scaleX(${1 + this.peakDb / METER_DB})`;
    const meter = this.meter.closest("[role=meter]");
    meter.setAttribute("aria-valuenow", Math.round(this.peakDb));
    meter.classList.toggle("loud", this.peakDb > COMPRESSED_DB);
  }

  drawTraces() {
    const g = this.traces.getContext("2d"), { width, height } = this.traces, ratio = devicePixelRatio;
    g.clearRect(0, 0, width, height);
    const n = this.peaks.length / 2, now = this.frame / PERIOD, middle = height * 0.36, reach = height * 0.32;
    const largest = this.largest;
    let high = 0.05;
    for (const value of this.peaks) high = Math.max(high, Math.abs(value));
    largest.acceleration += (high > largest.acceleration ? 0.5 : 0.02) * (high - largest.acceleration);
    g.strokeStyle = this.ink.line;
    g.lineWidth = ratio;
    g.beginPath();
    g.moveTo(0, middle);
    g.lineTo(width, middle);
    g.stroke();
    g.fillStyle = this.ink.acceleration;
    const columns = Math.ceil(width / ratio);
    for (let column = 0; column < columns; column++) {
      let low = 0, up = 0;
      const from = Math.floor(now - n + (column / columns) * n), to = Math.max(from + 1, Math.floor(now - n + ((column + 1) / columns) * n));
      for (let i = from; i < to; i++) {
        const at = ((i % n) + n) % n;
        low = Math.min(low, this.peaks[2 * at]);
        up = Math.max(up, this.peaks[2 * at + 1]);
      }
      if (low === 0 && up === 0) continue;
      const top = middle - (up / largest.acceleration) * reach, bottom = middle - (low / largest.acceleration) * reach;
      g.fillRect(column * ratio, top, ratio * 0.8, Math.max(ratio, bottom - top));
    }
    this.line(g, 1, "speed", 20, height);
    this.line(g, 2, "force", 0.2, height);
  }

  line(g, which, name, least, height) {
    const { conditions } = this, { width } = this.traces, ratio = devicePixelRatio;
    let high = least;
    for (const one of conditions) high = Math.max(high, one[which]);
    this.largest[name] += (high > this.largest[name] ? 0.5 : 0.02) * (high - this.largest[name]);
    g.strokeStyle = this.ink[name];
    g.lineWidth = 2 * ratio;
    g.lineJoin = "round";
    g.beginPath();
    for (const one of conditions) {
      const x = width * (1 - (this.frame - one[0]) / (SECONDS * this.rate)), y = height - 2 * ratio - (one[which] / this.largest[name]) * height * 0.26;
      g.lineTo(x, y);
    }
    g.stroke();
  }

  drawSpectrum() {
    const canvas = this.spectrogram, g = canvas.getContext("2d"), { width, height } = canvas;
    const wanted = ((this.frame - this.shown) / (SECONDS * this.rate)) * width, n = Math.min(width, Math.floor(wanted));
    if (n < 1) return;
    this.shown += (n / width) * SECONDS * this.rate;
    if (wanted > width) this.shown = this.frame;
    g.drawImage(canvas, -n, 0);
    this.bins ??= new Float32Array(this.analyser.frequencyBinCount);
    this.analyser.getFloatFrequencyData(this.bins);
    const column = g.createImageData(1, height), perBin = this.rate / this.analyser.fftSize;
    for (let y = 0; y < height; y++) {
      const at = LOWEST_HZ * (HIGHEST_HZ / LOWEST_HZ) ** (1 - (y + 0.5) / height) / perBin, low = Math.floor(at);
      const db = this.bins[low] + (at - low) * (this.bins[low + 1] - this.bins[low]);
      const share = Math.min(1, Math.max(0, (db - LOUDEST_DB + RANGE_DB) / RANGE_DB));
      column.data.set([...this.ramp[Math.round(255 * (Number.isFinite(share) ? share : 0))], 255], 4 * y);
    }
    for (let i = 0; i < n; i++) g.putImageData(column, width - n + i, 0);
  }
}

const channels = (colour) => colour.match(/[\d.]+/g).slice(0, 3).map(Number);
