// A texture under a stroke of two seconds that speeds up, as CSV on stdout: node stroke.mjs denim.foten > stroke.csv
import { readFileSync } from "node:fs";
import { Foten } from "../../packages/foten/native/wasm/foten.mjs";

const [path] = process.argv.slice(2);
if (!path) {
  console.error("usage: node stroke.mjs TEXTURE.foten");
  process.exit(2);
}
try {
  const foten = await Foten.load(readFileSync(new URL("../../packages/foten/native/wasm/foten.wasm", import.meta.url)));
  const texture = foten.texture(readFileSync(path));
  const { info } = texture;
  console.error(`${info.texture}, ${info.model}, ${info.rate} Hz, rendered with ${foten.isa}`);
  const renderer = texture.renderer({ smooth: true }); // the condition is set once a block: its steps would be perceptible
  const block = new Float32Array(32), n = Math.floor(2 * info.rate), [slow, fast] = info.trainedSpeed;
  const lines = ["t,speed_mm_s,acceleration_m_s2"];
  for (let first = 0; first < n; first += block.length) {
    const speed = slow + ((fast - slow) * first) / n;
    renderer.setCondition(speed, 0.8);
    const samples = renderer.render(block.subarray(0, n - first));
    samples.forEach((x, i) => lines.push(`${(first + i) / info.rate},${Math.fround(speed)},${x}`));
  }
  console.log(lines.join("\n"));
} catch (error) {
  console.error(`${path}: ${error.message}`);
  process.exit(2);
}
