// A page without NiceGUI: light or dark as the system, and a name of this tab for the server's rates.
"use strict";

(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const colour = () => document.body.classList.toggle("body--dark", dark.matches);
  dark.addEventListener("change", colour);
  colour();
  document.querySelector("main").dataset.page = String(Math.random()).slice(2);
  document.body.classList.add("ready");
})();
