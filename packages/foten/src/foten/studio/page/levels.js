// What is to be known of an input while it is recorded: its level, clipping, silence, hum.

const CLIPPED = 0.99; // of full scale
const CLIPS = 3; // clipped samples of one piece, which is more than a knock's tip
const SILENT_DB = -66, FAINT_DB = 10; // of full scale; and above what the input hears without a stroke
const LOST = 128; // zeros in a row between sounds: a browser puts them for what it did not get in time
const SILENT_S = 0.5; // of zeros, which is an input that is switched off
const STROKED = 60, FADES = 0.997, SLOW = 0.01; // pieces until a stroke is judged; per piece, of its loudest and of a pause
const HUM_SHARE = 0.5, HUM_DB = -26; // of what is heard between strokes; against a stroke
const HUM_S = 0.5; // that a hum is looked for in

export class Levels {
  constructor(rate) {
    Object.assign(this, { rate, rms: 0, peak: 0, clipped: 0, zeros: 0, sounds: false, lost: 0, stroked: 0, stroke: null, pause: null, hum: null });
    this.held = new Float32Array(Math.round(HUM_S * rate));
    this.n = 0;
  }

  /** Take in a piece; `down` says whether the pen touches. */
  add(piece, down) {
    let sum = 0, squares = 0, peak = 0, clips = 0;
    for (const value of piece) {
      if (value !== 0) {
        if (this.sounds && this.zeros >= LOST && this.zeros < SILENT_S * this.rate) this.lost++;
        this.zeros = 0;
        this.sounds = true;
      } else this.zeros++;
      sum += value;
      squares += value * value;
      peak = Math.max(peak, Math.abs(value));
      if (Math.abs(value) >= CLIPPED) clips++;
    }
    const power = Math.max(0, squares / piece.length - (sum / piece.length) ** 2);
    this.rms = Math.sqrt(power);
    this.peak = peak;
    if (clips >= CLIPS) this.clipped++;
    if (down) {
      this.n = 0;
      if (++this.stroked > STROKED) this.stroke = Math.max(power, (this.stroke ?? 0) * FADES);
      return;
    }
    this.pause = this.pause === null ? power : Math.min(power, this.pause) + SLOW * Math.max(0, power - this.pause);
    this.pauses(piece);
  }

  pauses(piece) {
    for (const value of piece) {
      this.held[this.n++] = value;
      if (this.n === this.held.length) {
        this.hum = humIn(this.held, this.rate);
        this.n = 0;
      }
    }
  }

  /** What is wrong with the input before anything is recorded; null where nothing is. */
  get unfit() {
    if (this.clipped > 2) return "It clips: turn the input down.";
    if (this.hum?.share > HUM_SHARE) return `It hums at ${this.hum.hz} Hz: try another cable, or a battery.`;
    return null;
  }

  /** What is wrong with what is recorded, in words; null where nothing is. */
  get trouble() {
    const db = (power) => 10 * Math.log10(Math.max(power, 1e-20));
    if (this.lost > 0) return "Parts of the sound are missing: close other pages and programs, and begin again.";
    if (this.clipped > 2) return "It clips: turn the input down.";
    if (this.stroke !== null && db(this.stroke) < SILENT_DB) return "The input is silent: is it the right one?";
    if (this.stroke !== null && this.pause !== null && db(this.stroke) - db(this.pause) < FAINT_DB)
      return "The stroke is hardly louder than the room: turn the input up, or fix the microphone more firmly.";
    if (this.hum?.share > HUM_SHARE && (this.stroke === null || db(this.hum.power) - db(this.stroke) > HUM_DB))
      return `It hums at ${this.hum.hz} Hz: try another cable, or a battery.`;
    return null;
  }
}

/** Return which mains frequency a pause holds most of, the share of its power, and that power. */
export function humIn(samples, rate) {
  const mean = samples.reduce((sum, value) => sum + value, 0) / samples.length;
  let all = 0;
  for (const value of samples) all += (value - mean) ** 2 / samples.length;
  const of = (hz) => {
    const step = (2 * Math.PI * hz) / rate;
    let re = 0, im = 0;
    for (let i = 0; i < samples.length; i++) {
      re += (samples[i] - mean) * Math.cos(step * i);
      im += (samples[i] - mean) * Math.sin(step * i);
    }
    return (2 * (re * re + im * im)) / samples.length ** 2;
  };
  const found = [50, 60].map((hz) => ({ hz, power: of(hz) + of(2 * hz) + of(3 * hz) }));
  const most = found[0].power > found[1].power ? found[0] : found[1];
  return { ...most, share: all > 0 ? most.power / all : 0 };
}
