// A page without NiceGUI: a name of this tab for the server's rates.
"use strict";

document.querySelector("main").dataset.page = String(Math.random()).slice(2);
document.body.classList.add("ready");
