// Sliders that move the texture under the hand while it strokes: louder, brighter, wider, rougher, another period, towards another texture.
//
// The server moves it, as `foten edit` and `foten blend` do: roughly while a slider moves, to the point once it is let go. What comes
// is a texture file like any other; the worklet fades over to it.

const MOVES = { level: ["louder", 12, "dB"], brighter: ["brighter", 1.5, "oct"], wider: ["wider", 0.6, "oct"], rougher: ["rougher", 3, "dB"], period: ["period", 1, "oct"] };
const FADED_MS = 60; // after which the worklet has left what played before

export class Tune {
  /** `one()` is the texture on the stage, `others()` what it may be blended with; `played` takes what plays, `say` a line for people. */
  constructor(panel, sound, { one, others, played, say }) {
    Object.assign(this, { panel, sound, one, others, played, say, busy: false, wanted: null, turn: 0, bytes: null });
    const slider = (name, [label, most]) =>
      `<label for="tune-${name}">${label}</label><input id="tune-${name}" name="${name}" type="range" min="${-most}" max="${most}" step="any" value="0"><output for="tune-${name}"></output>`;
    panel.innerHTML = `<form>${Object.entries(MOVES).map((one) => slider(...one)).join("")}
      <label for="tune-other">towards</label><select id="tune-other" name="other" aria-label="towards the texture"></select>
      <span></span><input id="tune-at" name="at" type="range" min="0" max="1" step="any" value="0" aria-label="share of the way"><output for="tune-at"></output>
      <div><button type="reset" class="plain">Reset</button><button id="tune-save" type="button" class="plain main" disabled>Save</button></div></form>`;
    this.form = panel.firstElementChild;
    this.form.addEventListener("submit", (e) => e.preventDefault());
    this.form.addEventListener("input", () => this.move(false));
    this.form.addEventListener("change", () => this.move(true));
    this.form.addEventListener("reset", () => setTimeout(() => this.move(true)));
    panel.querySelector("#tune-save").addEventListener("click", () => this.save());
  }

  get shown() {
    return !this.panel.hidden;
  }

  /** Show or hide the sliders; hidden, the texture is its own again. */
  show(on) {
    this.panel.hidden = !on;
    if (on) this.fill();
    else this.release();
  }

  /** Begin anew for the texture on the stage. */
  fill() {
    const others = this.others();
    this.form.reset();
    this.form.other.replaceChildren(...others.map(({ file, title }) => new Option(title, file)));
    for (const part of [this.form.other, this.form.at]) part.disabled = !others.length;
    this.bytes = null;
    this.label();
  }

  release() {
    this.wanted = null;
    const texture = this.one();
    if (texture && this.sound.id !== texture.id && this.sound.infos.has(texture.id)) {
      this.sound.use(texture.id);
      texture.bytes.then(this.played, () => {});
    }
    for (const id of ["tuned-0", "tuned-1"]) setTimeout(() => this.sound.id !== id && this.sound.drop(id), FADED_MS);
  }

  label() {
    for (const [name, [, , unit]] of Object.entries(MOVES)) {
      const value = Number(this.form[name].value);
      this.form[name].nextElementSibling.value = value ? `${value > 0 ? "+" : "−"}${Math.abs(value).toFixed(name === "level" ? 0 : 1)} ${unit}` : "";
    }
    this.form.at.nextElementSibling.value = Number(this.form.at.value) ? `${Math.round(100 * this.form.at.value)} %` : "";
    this.panel.querySelector("#tune-save").disabled = !this.bytes;
  }

  /** Ask for what the sliders say, once the last answer is there. */
  async move(exact) {
    this.label();
    this.wanted = { exact, texture: this.one() };
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.wanted) {
        const { exact, texture } = this.wanted;
        this.wanted = null;
        await this.play(texture, exact);
      }
    } catch (error) {
      this.say(error.message);
    } finally {
      this.busy = false;
      this.label();
    }
  }

  async play(texture, exact) {
    const { form, sound } = this, query = new URLSearchParams({ texture: texture.file, exact: Number(exact) });
    for (const name of [...Object.keys(MOVES), "at"]) if (Number(form[name].value)) query.set(name, form[name].value);
    if (query.has("at")) query.set("other", form.other.value);
    if ([...query.keys()].length === 2) {
      this.bytes = null;
      sound.use(texture.id);
      this.played(await texture.bytes);
      return;
    }
    const answer = await fetch(`tuned?${query}`, { method: "POST" }); // whose origin the server checks
    if (!answer.ok) throw new Error((await answer.text()).trim());
    const bytes = await answer.arrayBuffer();
    if (!this.shown || this.one() !== texture) return; // another texture was chosen meanwhile
    const id = `tuned-${(this.turn ^= 1)}`, playing = sound.infos.get(texture.id);
    const info = await sound.load(id, bytes);
    sound.know(id, { ...info, accelerationSd: playing.accelerationSd }); // louder is louder
    sound.use(id);
    this.played(bytes);
    this.bytes = exact ? bytes : null;
    await new Promise((done) => setTimeout(done, FADED_MS)); // the next may not take the place of what still fades
  }

  /** The texture as a file. */
  save() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([this.bytes]));
    link.download = `${this.one().file.replace(/\.foten$/, "")}-edited.foten`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}
