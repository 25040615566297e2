// A texture under a stroke that speeds up, as CSV on stdout: node stroke.mjs denim.foten > stroke.csv
import { readFileSync } from "node:fs";
import { Foten } from "../../native/wasm/foten.mjs";

const [path] = process.argv.slice(2);
if (!path) {
  console.error("usage: node stroke.mjs TEXTURE.foten");
  process.exit(2);
}
try {
  const foten = await Foten.load(readFileSync(new URL("../../native/wasm/foten.wasm", import.meta.url)));
  const texture = foten.texture(readFileSync(path));
  const { info } = texture;
  console.error(`${info.texture}, ${info.model}, ${info.rate} Hz, rendered with ${foten.isa}`);
  const renderer = texture.renderer();
  const block = new Float32Array(20);
  const lines = ["t,speed_mm_s,acceleration_m_s2"];
  for (let b = 0; b < 100; b++) {
    const speed = info.trainedSpeed[0] + ((info.trainedSpeed[1] - info.trainedSpeed[0]) * b) / 100;
    renderer.setCondition(speed, 0.8);
    renderer.render(block).forEach((x, i) => lines.push(`${(b * 20 + i) / info.rate},${Math.fround(speed)},${x}`));
  }
  console.log(lines.join("\n"));
} catch (error) {
  console.error(`${path}: ${error.message}`);
  process.exit(2);
}
