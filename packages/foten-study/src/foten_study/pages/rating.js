// An answer on scales, one or several.
import { el, scale, words } from "./elements.js";

export function answer({ scales }, changed) {
  const fields = scales.map(({ key, question, lowest, highest }) => ({ key, question, ...scale(lowest, highest, question) }));
  for (const { input } of fields) input.addEventListener("set", changed);
  return {
    elements: [el("div", { className: "scales" }, ...fields.map(({ question, element }) => el("div", { className: "asked" }, el("h2", {}, question), element)))],
    given: () => fields.every(({ input }) => input.dataset.set),
    lacks: words.choose_place,
    values: () => Object.fromEntries(fields.map(({ key, input }) => [key, Number(input.value)])),
    set: (values) => {
      for (const { key, input } of fields) {
        input.value = values[key];
        input.dispatchEvent(new Event("input"));
      }
    },
  };
}
