// Renders on the audio thread, 128 samples a call; what is shown is sent every 32nd.
import { Foten } from "./foten.mjs";

class FotenProcessor extends AudioWorkletProcessor {
  constructor({ processorOptions: { module, bytes } }) {
    super();
    this.gain = 0;
    this.calls = 0;
    try {
      const texture = Foten.start(module).texture(bytes);
      this.renderer = texture.renderer({ rate: sampleRate });
      this.stylus = this.renderer.stylus();
      this.port.postMessage({ info: texture.info });
    } catch (error) {
      this.port.postMessage({ error: error.message });
    }
    this.port.onmessage = ({ data }) => {
      if (data.event) this.stylus?.push(...data.event);
      if (data.gain) this.gain = data.gain;
      if (data.stop) {
        this.renderer?.free();
        this.renderer = null;
      }
    };
  }

  process(_inputs, [[out]]) {
    if (!this.renderer) return false;
    this.renderer.renderStylus(this.stylus, out);
    for (let i = 0; i < out.length; i++) out[i] = Math.max(-1, Math.min(1, this.gain * out[i]));
    if (++this.calls % 32 === 0) this.port.postMessage({ condition: this.renderer.condition });
    return true;
  }
}

registerProcessor("foten", FotenProcessor);
