// Driving from a browser: presses, releases, requests and stops.
//
// An element's attribute says what it does:
//   data-press="x:1"                          press = one step of axis x, hold = run; "x:-1 y:1": two axes at once
//   data-send='{"do": "goto", "axis": "x"}'   a request; the page's fields are put in where it names them
//   data-stop                                 stop
//   data-fields="to:target_x"                 fields of a request: key:name of the input
// Everything is sent at once or not at all: nothing is kept for later (see socket.py).
"use strict";

(() => {
  const ARROWS = { ArrowUp: "y:1", ArrowDown: "y:-1", ArrowLeft: "x:-1", ArrowRight: "x:1" };
  const AGAIN_MS = 500; // between two attempts to reach the panel
  const BEAT_MS = 20; // the least between two beats: ticks that were held back come all at once
  const SILENT_MS = 1000; // a panel that is not heard of for so long is not reached

  let socket = null;
  let tick = null; // the last that the panel has sent
  let heardAt = -Infinity; // when it came
  let beatAt = -Infinity; // when the last beat was sent
  let held = null; // {element, by}: what is down, and which pointer or key holds it
  let key = null; // the secret of this page

  const field = (name) => document.querySelector(`:is(input, select)[name="${name}"]`)?.value ?? "";

  function send(message) {
    if (socket?.readyState !== WebSocket.OPEN) return false;
    socket.send(JSON.stringify({ ...message, tick }));
    return true;
  }

  // ---- the connection

  function connect() {
    key ??= document.querySelector("[data-page]")?.dataset.page ?? null;
    if (key === null) {
      setTimeout(connect, 50);
      return;
    }
    remembered();
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/drive`);
    // the first message: this page's own secret, and the one that signing in has left (sign_in.py)
    socket.onopen = () => socket.send(JSON.stringify({ page: key, key: localStorage.getItem("mirrormount-key") }));
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = (event) => {
      held = tick = null;
      document.body.classList.remove("ready");
      document.body.classList.add("cut");
      if (event.code === 4404) location.reload(); // the panel was started anew
      else if (event.code === 4401) location.replace("/enter"); // the key is missing
      else setTimeout(connect, AGAIN_MS);
    };
  }

  function receive(message) {
    tick = message.tick;
    heardAt = performance.now();
    document.body.classList.remove("cut");
    document.body.classList.add("ready");
    if (heardAt - beatAt > BEAT_MS) {
      beatAt = heardAt;
      send({ do: "beat" });
    }
    if (message.spot) window.mountScreen?.(message.spot);
  }

  // A network that keeps everything back closes no socket.
  setInterval(() => {
    if (tick === null || performance.now() - heardAt < SILENT_MS) return;
    letGo();
    document.body.classList.remove("ready");
    document.body.classList.add("cut");
  }, 250);

  // ---- stop: by the socket, and by a request of its own if the socket is stuck

  function stop() {
    letGo();
    send({ do: "stop" });
    fetch("/stop", { method: "POST", keepalive: true }).catch(() => {});
    for (const element of document.querySelectorAll("[data-stop]")) {
      element.classList.add("pressed");
      setTimeout(() => element.classList.remove("pressed"), 150);
    }
  }

  // ---- press and hold

  function press(element, by, coarse) {
    if (held || element.disabled) return;
    const ways = element.dataset.press.split(" ").map((way) => way.split(":"));
    const axes = Object.fromEntries(ways.map(([axis, way]) => [axis, Number(way)]));
    if (!send({ do: "press", ...axes, coarse, speed: field("speed") })) return;
    held = { element, by };
    element.classList.add("held");
  }

  function letGo() {
    if (!held) return;
    held.element.classList.remove("held");
    held = null;
    send({ do: "release" });
  }

  function request(element) {
    const message = JSON.parse(element.dataset.send);
    for (const pair of (element.dataset.fields ?? "").split(" ").filter(Boolean)) {
      const [name, input] = pair.split(":");
      message[name] = field(input).trim();
    }
    send(message);
  }

  // ---- the slider: this browser remembers it

  const SPEED = "mirrormount-speed";

  function show(input) {
    const shown = document.querySelector(`[data-shows="${input.name}"]`);
    if (shown) shown.textContent = input.value;
  }

  function remembered() {
    const input = document.querySelector('input[name="speed"]');
    const speed = Number(localStorage.getItem(SPEED));
    if (!input || !(speed >= Number(input.min) && speed <= Number(input.max))) return;
    input.value = speed;
    show(input);
  }

  document.addEventListener("input", (event) => {
    show(event.target);
    if (event.target.name === "speed") localStorage.setItem(SPEED, event.target.value);
  });

  const under = (event) => document.elementFromPoint(event.clientX, event.clientY)?.closest("[data-press]");

  document.addEventListener("pointerdown", (event) => {
    if (event.target.closest?.("[data-stop]")) {
      stop(); // when it goes down: not when it comes up again
      return;
    }
    const element = event.target.closest?.("[data-press]");
    if (!element || event.button !== 0) return;
    event.preventDefault();
    element.focus({ preventScroll: true });
    element.setPointerCapture?.(event.pointerId); // so that it is heard when it comes up outside the window
    press(element, event.pointerId, event.shiftKey);
  });
  document.addEventListener("pointermove", (event) => {
    if (held?.by !== event.pointerId) return;
    const up = !(event.buttons & 1); // there is no pointerup while another button of the mouse is down
    if (up || under(event) !== held.element) letGo(); // or slid off
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
    document.addEventListener(kind, (event) => held?.by === event.pointerId && letGo());
  }
  document.addEventListener("contextmenu", (event) => {
    if (event.target.closest?.("[data-press]")) event.preventDefault();
    else letGo(); // the menu takes the keys: one that comes up over it is not told to the page
  });
  document.addEventListener("dragstart", letGo); // and so does what is dragged
  document.addEventListener("click", (event) => {
    if (event.target.closest?.("[data-stop]")) stop(); // a screen reader clicks, and presses nothing
    const element = event.target.closest?.("[data-send]");
    if (element && !element.disabled) request(element);
  });

  // ---- keys

  const typing = (target) => target.closest?.("input, textarea, select, [contenteditable], [role=slider], [role=tab]");

  document.addEventListener(
    "keydown",
    (event) => {
      if (event.key === "Escape") {
        stop();
        return;
      }
      if (event.metaKey) letGo(); // macOS tells of no key that comes up while Cmd is down
      const focused = event.target.closest?.("[data-press], [data-stop]");
      const push = event.key === " " || event.key === "Enter";
      if (focused && push) {
        event.preventDefault();
        if (event.repeat) return;
        if (focused.matches("[data-stop]")) stop();
        else press(focused, event.code, event.shiftKey);
        return;
      }
      const way = ARROWS[event.key];
      if (!way || typing(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      const element = document.querySelector(`[data-press="${way}"]`);
      if (element && !event.repeat) press(element, event.code, event.shiftKey);
    },
    true,
  );
  document.addEventListener("keyup", (event) => held?.by === event.code && letGo(), true);

  // ---- whatever takes the page away from its user

  window.addEventListener("blur", letGo);
  window.addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());

  // Enter in a field of a request sends that request.
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || !event.target.matches?.("input[name]")) return;
    const name = event.target.name;
    const element = document.querySelector(`[data-enter~="${name}"]`);
    if (element && !element.disabled) request(element);
  });

  window.mountSend = send; // a click on the picture (camera.js)
  window.mountTick = () => tick; // for what NiceGUI's own buttons ask

  connect();
})();
