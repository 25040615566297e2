// What the scripts of a study's page share: elements, and the words of its language.
import { filled, written } from "./settings.js";

export const words = JSON.parse(document.getElementById("words").textContent);
export const worded = (key, values = {}) => filled(words[key], values);

/** Return an element with attributes and children. */
export function el(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes))
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key in element && key !== "list") element[key] = value;
    else element.setAttribute(key, value);
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** A slider without a position until one is chosen. */
export function scale(lowest, highest, label) {
  const input = el("input", { type: "range", min: 0, max: 100, step: 1, value: 50, ariaLabel: label });
  input.setAttribute("aria-valuetext", words.not_set);
  const set = () => {
    input.dataset.set = "true";
    input.setAttribute("aria-valuetext", written(input.value));
    input.dispatchEvent(new Event("set"));
  };
  for (const type of ["input", "pointerup"]) input.addEventListener(type, set);
  return { input, element: el("div", { className: "scale" }, input, el("span", {}, lowest), el("span", {}, highest)) };
}
