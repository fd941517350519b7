// The colours of a page: as the system, dark, light, or night: dark, and nothing but red, for eyes used to the dark.
// This browser remembers it. The script runs before anything is drawn: at night no page may begin in white.
// An element with data-mode is the button that changes it.
"use strict";

(() => {
  const MODES = { auto: "◐", dark: "●", light: "○", night: "◉" };
  const ORDER = Object.keys(MODES);
  const KEY = "mirrormount-mode";
  // What is no text is painted by these: of each colour only red is left, as bright as the colour was. A picture keeps its
  // brightness, a drawing is made brighter: its lines are thin.
  const RED = { "red-picture": "0.5 0.35 0.15", "red-drawing": "1 0.7 0.3" };
  const FILTERS = Object.entries(RED).map(
    ([id, weights]) => `<filter id="${id}" color-interpolation-filters="sRGB">
      <feColorMatrix values="${weights} 0 0  0 0 0 0 0  0 0 0 0 0  0 0 0 1 0"/></filter>`,
  );

  const after = (name) => ORDER[(ORDER.indexOf(name) + 1) % ORDER.length];

  const system = matchMedia("(prefers-color-scheme: dark)");
  let mode = localStorage.getItem(KEY);
  if (!(mode in MODES)) mode = "auto";

  function paint() {
    document.documentElement.classList.toggle("night", mode === "night");
    const button = document.querySelector("[data-mode]");
    if (!button) return;
    button.textContent = `${MODES[mode]} ${mode}`;
    button.setAttribute("aria-label", `Colours: ${mode}; press for ${after(mode)}`);
    if (window.setDark) window.setDark(mode === "auto" ? null : mode !== "light"); // a page of NiceGUI
    else document.body.classList.toggle("body--dark", mode === "auto" ? system.matches : mode !== "light");
  }

  function begin() {
    if (!document.querySelector("[data-mode]")) {
      setTimeout(begin, 50);
      return;
    }
    document.body.insertAdjacentHTML("beforeend", `<svg class="filters" aria-hidden="true">${FILTERS.join("")}</svg>`);
    paint();
  }

  window.mountMode = (name) => {
    mode = name;
    paint();
  };
  document.addEventListener("click", (event) => {
    if (!event.target.closest?.("[data-mode]")) return;
    window.mountMode(after(mode));
    localStorage.setItem(KEY, mode);
  });
  system.addEventListener("change", paint);
  paint();
  begin();
})();
