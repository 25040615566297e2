// An answer that is one of the surfaces.
import { el, words } from "./elements.js";

export function answer({ question, choices }, changed) {
  const inputs = choices.map((_, i) => el("input", { type: "radio", name: "choice", value: i, onchange: changed }));
  const labels = choices.map((name, i) => el("label", { className: "choice" }, inputs[i], el("span", {}, name)));
  return {
    elements: [el("fieldset", { className: "asked" }, el("legend", {}, question), ...labels)],
    given: () => inputs.some((input) => input.checked),
    lacks: words.choose,
    values: () => ({ choice: inputs.findIndex((input) => input.checked) }),
    set: ({ choice }) => {
      inputs[choice].checked = true;
      changed();
    },
  };
}
