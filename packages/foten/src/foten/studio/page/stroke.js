// A stroke that was recorded: shown, downloaded, and replayed on another texture.

export class Taken {
  constructor(dialog, page) {
    Object.assign(this, { dialog, page });
    dialog.innerHTML = `
      <form method="dialog"><button class="icon close" aria-label="Close"><svg viewBox="0 0 24 24" aria-hidden="true"><path d="m6 6 12 12M18 6 6 18"/></svg></button></form>
      <h2>Your stroke</h2><canvas aria-label="What was rendered" role="img"></canvas><p><output></output></p>
      <div class="row"><button class="plain" data-do="csv" type="button">Stroke as CSV</button><button class="plain" data-do="wav" type="button">Vibration as WAV</button></div>
      <h3>Replay on</h3><div class="row"><select aria-label="Texture"></select><button class="plain main" data-do="replay" type="button">Replay</button></div>`;
    for (const button of dialog.querySelectorAll("[data-do]")) button.addEventListener("click", () => this[button.dataset.do]());
  }

  show(stroke, texture) {
    Object.assign(this, { stroke, texture });
    const { samples, events, rate } = stroke, peak = samples.reduce((high, value) => Math.max(high, Math.abs(value)), 0);
    this.dialog.querySelector("output").value = `${(samples.length / rate).toFixed(1)} s on ${texture.title}, ${events.length} events, up to ${peak.toPrecision(2)} ${this.unit}`;
    const options = this.page.groups().map(([one]) => new Option(one.title, one.id, one === texture, one === texture));
    this.dialog.querySelector("select").replaceChildren(...options);
    this.dialog.showModal();
    this.draw();
  }

  draw() {
    const canvas = this.dialog.querySelector("canvas"), g = canvas.getContext("2d"), { samples } = this.stroke;
    canvas.width = canvas.clientWidth * devicePixelRatio;
    canvas.height = canvas.clientHeight * devicePixelRatio;
    const { width, height } = canvas, high = samples.reduce((most, value) => Math.max(most, Math.abs(value)), 1e-9);
    g.fillStyle = getComputedStyle(canvas).color;
    for (let x = 0; x < width; x++) {
      const part = samples.subarray(Math.floor((x / width) * samples.length), Math.max(1, Math.floor(((x + 1) / width) * samples.length)));
      const size = part.reduce((most, value) => Math.max(most, Math.abs(value)), 0) / high;
      g.fillRect(x, (height / 2) * (1 - 0.95 * size), 0.8, Math.max(1, height * 0.95 * size));
    }
  }

  /** As `foten render --stroke` reads it: t [s], x and y [mm], pressure 0 … 1. */
  csv() {
    const { events, rate } = this.stroke;
    const begin = events.length ? events[0][4] - events[0][0] / rate : 0; // of the WAV: both count from the same moment
    const rows = events.map(([, x, y, pressure, t]) => [(t - begin).toFixed(6), x.toFixed(4), y.toFixed(4), pressure.toFixed(4)].join(","));
    save(new Blob([["t,x,y,pressure", ...rows, ""].join("\n")], { type: "text/csv" }), `${this.name}.csv`);
  }

  /** Its peak is full scale; the file says, in itself and in its name, how much that is. */
  wav() {
    const { samples, rate } = this.stroke, peak = samples.reduce((high, value) => Math.max(high, Math.abs(value)), 0) || 1;
    const said = `${peak.toPrecision(4)} ${this.unit}`;
    save(wavOf(samples.map((value) => value / peak), rate, `foten: ${this.texture.title}, full scale is ${said}`), `${this.name}-full-scale-${peak.toPrecision(4)}.wav`);
  }

  get unit() {
    return this.page.unit();
  }

  get name() {
    return this.texture.title.toLowerCase().replaceAll(" ", "-");
  }

  async replay() {
    const { page, stroke } = this, id = this.dialog.querySelector("select").value;
    const [texture] = page.groups().find(([one]) => one.id === id);
    this.dialog.close();
    await page.use(texture);
    const { pad } = page, events = stroke.events, first = events[0]?.[4] ?? 0, begin = performance.now(), mine = (pad.ghost = {});
    let i = 0;
    const step = () => {
      if (pad.ghost !== mine) return;
      const now = performance.now();
      for (; i < events.length && begin + 1000 * (events[i][4] - first) <= now; i++) {
        const [, x, y, pressure, t] = events[i];
        pad.event(x / pad.mmPerPx, y / pad.mmPerPx, pressure, begin + 1000 * (t - first));
      }
      if (i < events.length) setTimeout(step, 2);
      else pad.ghost = null;
    };
    step();
  }
}

/** Return a sound of one channel in 32-bit floats, and a comment in it. */
export function wavOf(samples, rate, comment = "") {
  const said = new TextEncoder().encode(comment), room = said.length + 1 + ((said.length + 1) % 2), list = comment ? 20 + room : 0;
  const bytes = new DataView(new ArrayBuffer(58 + list + 4 * samples.length));
  const text = (at, word) => [...word].forEach((letter, i) => bytes.setUint8(at + i, letter.charCodeAt(0)));
  text(0, "RIFF");
  bytes.setUint32(4, 50 + list + 4 * samples.length, true);
  text(8, "WAVEfmt ");
  bytes.setUint32(16, 18, true);
  bytes.setUint16(20, 3, true); // IEEE floats
  bytes.setUint16(22, 1, true);
  bytes.setUint32(24, rate, true);
  bytes.setUint32(28, 4 * rate, true);
  bytes.setUint16(32, 4, true);
  bytes.setUint16(34, 32, true);
  text(38, "fact");
  bytes.setUint32(42, 4, true);
  bytes.setUint32(46, samples.length, true);
  if (list) {
    text(50, "LIST");
    bytes.setUint32(54, list - 8, true);
    text(58, "INFOICMT");
    bytes.setUint32(66, said.length + 1, true);
    said.forEach((value, i) => bytes.setUint8(70 + i, value));
  }
  const at = 50 + list;
  text(at, "data");
  bytes.setUint32(at + 4, 4 * samples.length, true);
  samples.forEach((value, i) => bytes.setFloat32(at + 8 + 4 * i, value, true));
  return new Blob([bytes.buffer], { type: "audio/wav" });
}

export function save(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
