// Driving from a browser: presses, releases, requests and stops.
//
// An element's attribute says what it does:
//   data-press="x:1"                          press = one step of axis x, hold = run; "x:-1 y:1": two axes at once
//   data-send='{"do": "goto", "axis": "x"}'   a request; the page's fields are put in where it names them
//   data-stop                                 stop
//   data-fields="to:target_x"                 fields of a request: key:name of the input
//   data-of="mount-1"                         it belongs to the mount of that id, and stands elsewhere (in a dialog)
//   data-remember                             this browser remembers what the field has, for each mount (data-mount)
// An element with data-page holds what belongs to one mount; each has a connection of its own. Only STOP is for all.
// Everything is sent at once or not at all: nothing is kept for later (see socket.py).
"use strict";

(() => {
  const ARROWS = { ArrowUp: "y:1", ArrowDown: "y:-1", ArrowLeft: "x:-1", ArrowRight: "x:1" };
  const AGAIN_MS = 500; // between two attempts to reach the panel
  const BEAT_MS = 20; // the least between two beats: ticks that were held back come all at once
  const SILENT_MS = 1000; // a panel that is not heard of for so long is not reached
  const SHOW_MS = 1000; // more than a fold takes to open

  let mounts = []; // the Mount of each element with data-page
  let held = null; // {element, by, mount}: what is down, and which pointer or key holds it
  let chosen = null; // the Mount that was touched last: arrow keys are for it

  // ---- a mount, and the connection that drives it

  class Mount {
    constructor(root, number) {
      this.root = root;
      this.number = number;
      this.socket = null;
      this.tick = null; // the last that the panel has sent
      this.heardAt = -Infinity; // when it came
      this.lost = false; // it was connected, or should be
      this.beatAt = -Infinity; // when the last beat was sent
      this.connect();
    }

    field(name) {
      return this.root.querySelector(`:is(input, select)[name="${name}"]`)?.value ?? "";
    }

    send(message) {
      if (this.socket?.readyState !== WebSocket.OPEN) return false;
      this.socket.send(JSON.stringify({ ...message, tick: this.tick }));
      return true;
    }

    connect() {
      const scheme = location.protocol === "https:" ? "wss" : "ws";
      const socket = (this.socket = new WebSocket(`${scheme}://${location.host}/drive`));
      // the first message: this page's own secret, and the one that signing in has left (sign_in.py)
      const secrets = { page: this.root.dataset.page, key: localStorage.getItem("mirrormount-key") };
      socket.onopen = () => socket.send(JSON.stringify(secrets));
      socket.onmessage = (event) => this.receive(JSON.parse(event.data));
      socket.onclose = (event) => {
        if (held?.mount === this) held = null;
        this.tick = null;
        this.lost = true;
        tellConnection();
        if (event.code === 4404) location.reload(); // the panel was started anew
        else if (event.code === 4401) location.replace("/enter"); // the key is missing
        else setTimeout(() => this.connect(), AGAIN_MS);
      };
    }

    receive(message) {
      this.tick = message.tick;
      this.heardAt = performance.now();
      this.lost = false;
      tellConnection();
      if (this.heardAt - this.beatAt > BEAT_MS) {
        this.beatAt = this.heardAt;
        this.send({ do: "beat" });
      }
      if (message.spot) window.mountScreen?.(message.spot, this.root);
    }

    get connected() {
      return this.tick !== null && performance.now() - this.heardAt < SILENT_MS;
    }
  }

  function tellConnection() {
    document.body.classList.toggle("ready", mounts.every((mount) => mount.connected));
    document.body.classList.toggle("cut", mounts.some((mount) => mount.lost));
  }

  // A network that keeps everything back closes no socket.
  setInterval(() => {
    for (const mount of mounts.filter((one) => one.tick !== null && !one.connected)) {
      if (held?.mount === mount) letGo();
      mount.lost = true;
      tellConnection();
    }
  }, 250);

  const mountOf = (element) => {
    const root = element.closest?.("[data-page]") ?? document.getElementById(element.closest?.("[data-of]")?.dataset.of);
    return mounts.find((mount) => mount.root === root) ?? (mounts.length === 1 ? mounts[0] : null);
  };

  function choose(mount) {
    if (!mount || mount === chosen) return;
    chosen = mount;
    for (const one of mounts) one.root.toggleAttribute("data-keys", one === chosen);
  }

  function begin() {
    const roots = [...document.querySelectorAll("[data-page]")];
    mounts = roots.map((root, number) => new Mount(root, number));
    mounts.forEach(restore);
    if (mounts.length === 1) chosen = mounts[0];
    if (!roots.length) setTimeout(begin, 50);
  }

  // ---- stop: by the socket, and by a request of its own if the socket is stuck

  function stop() {
    letGo();
    for (const mount of mounts) mount.send({ do: "stop" });
    fetch("/stop", { method: "POST", keepalive: true }).catch(() => {});
    for (const element of document.querySelectorAll("[data-stop]")) {
      element.classList.add("pressed");
      setTimeout(() => element.classList.remove("pressed"), 150);
    }
  }

  // ---- press and hold

  function press(element, by, fine) {
    const mount = mountOf(element);
    if (held || element.disabled || !mount) return;
    const ways = element.dataset.press.split(" ").map((way) => way.split(":"));
    const axes = Object.fromEntries(ways.map(([axis, way]) => [axis, Number(way)]));
    if (!mount.send({ do: "press", ...axes, fine, speed: mount.field("speed"), steps: mount.field("press_steps") })) return;
    held = { element, by, mount };
    element.classList.add("held");
  }

  // The same by a key or a gamepad, which has no place on the page: it is for the mount that was touched last.
  function pressChosen(way, by, fine) {
    const element = chosen?.root.querySelector(`[data-press="${way}"]`);
    if (element) press(element, by, fine);
  }

  function letGo() {
    if (!held) return;
    const { element, mount } = held;
    held = null;
    element.classList.remove("held");
    mount.send({ do: "release" });
  }

  function request(element) {
    const mount = mountOf(element);
    if (!mount) return;
    const message = JSON.parse(element.dataset.send);
    for (const pair of (element.dataset.fields ?? "").split(" ").filter(Boolean)) {
      const [name, input] = pair.split(":");
      message[name] = mount.field(input).trim();
    }
    mount.send(message);
  }

  // ---- fields that this browser remembers

  let filling = false; // a field is filled by this file, not by a person

  const memoryOf = (mount, field) => [`mirrormount-${field.name}`, mount.root.dataset.mount].filter(Boolean).join(" ");

  // With its neighbours: an amount counts in the unit beside it, which need not be the remembered one (giveUp).
  function remember(mount, field) {
    const fields = field.closest(".line")?.querySelectorAll("[data-remember]") ?? [field];
    for (const one of fields) localStorage.setItem(memoryOf(mount, one), one.value);
  }

  function fill(field, value) {
    const before = field.value;
    field.value = value;
    const taken = field.value === value && field.selectedIndex !== -1;
    if (!taken) field.value = before; // it cannot have that: out of a slider's range, no such choice
    filling = true;
    field.dispatchEvent(new Event("input", { bubbles: true })); // the page's framework keeps a copy
    filling = false;
  }

  function restore(mount) {
    for (const field of mount.root.querySelectorAll("[data-remember]")) {
      const value = localStorage.getItem(memoryOf(mount, field));
      if (value !== null) fill(field, value);
    }
    const choices = [...mount.root.querySelectorAll("select")];
    const check = () => choices.filter((choice) => choice.selectedOptions[0]?.disabled).forEach(giveUp);
    check();
    for (const choice of choices) new MutationObserver(check).observe(choice, { subtree: true, attributeFilter: ["disabled"] });
  }

  // The chosen unit has no scale now. An amount that was typed for it is none in steps. The memory keeps
  // both, until a person types another amount or chooses another unit.
  function giveUp(choice) {
    const unit = choice.selectedOptions[0].textContent;
    fill(choice, choice.options[0].value);
    const line = choice.closest(".line");
    const amount = line?.querySelector("input");
    if (amount) fill(amount, "");
    const told = line?.querySelector("[data-lost]");
    if (told) told.textContent = `There is no scale for ${unit} now (mirrormount setup measures it): type the amount in steps.`;
  }

  document.addEventListener("input", ({ target }) => {
    const mount = mountOf(target);
    if (!mount) return;
    const shown = mount.root.querySelector(`[data-shows="${target.name}"]`);
    if (shown) shown.textContent = target.value;
    if (filling) return;
    if ("remember" in target.dataset) remember(mount, target);
    const told = target.closest(".line")?.querySelector("[data-lost]");
    if (told) told.textContent = "";
  });

  const under = (event) => document.elementFromPoint(event.clientX, event.clientY)?.closest("[data-press]");

  document.addEventListener("pointerdown", (event) => {
    if (event.target.closest?.("[data-stop]")) {
      stop(); // when it goes down: not when it comes up again
      return;
    }
    choose(mountOf(event.target));
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

  document.addEventListener("focusin", (event) => choose(mountOf(event.target)));
  // What a key has reached is brought into sight, for a second or until somebody scrolls: a fold that opens scrolls inside
  // and takes that back, and Chromium leaves a field with a list of proposals under STOP now and then.
  let reached = null;
  const keepInSight = (until) =>
    requestAnimationFrame((now) => {
      reached?.scrollIntoView({ block: "nearest", inline: "nearest" });
      if (reached && now < until) keepInSight(until);
    });
  document.addEventListener("focusin", ({ target, timeStamp }) => {
    reached = target.matches(":focus-visible") && !target.closest("header, footer") ? target : null;
    keepInSight(timeStamp + SHOW_MS);
  });
  for (const kind of ["wheel", "touchmove", "pointerdown"]) {
    document.addEventListener(kind, () => (reached = null), { passive: true });
  }

  const typing = (target) => target.closest?.("input, textarea, select, [contenteditable], [role=slider], [role=tab]");
  const FIELD = "input:not([type=range]), textarea, select, [contenteditable]";
  const PUSHED = "a[href], button, summary, .q-item, [role=button], [role=checkbox], [role=tab]";
  const DRIVES = "[data-press], [data-send], [data-stop]";
  // Space is for what has the focus, and no stop: in a field, and on a control that drives nothing.
  const usesSpace = (target) => target.closest?.(FIELD) || (target.closest?.(PUSHED) && !target.closest(DRIVES));
  let spaceStopped = false; // the space bar that is down has stopped

  document.addEventListener(
    "keydown",
    (event) => {
      if (event.key === "Escape") {
        if (!event.repeat) stop(); // one that is down for long stops once
        return;
      }
      if (event.code === "Space" && (held || spaceStopped || !usesSpace(event.target))) {
        event.preventDefault();
        event.stopPropagation(); // the page's framework would click what has the focus
        if (!spaceStopped || !event.repeat) stop(); // one that is down for long stops once
        spaceStopped = true;
        return;
      }
      if (event.metaKey) letGo(); // macOS tells of no key that comes up while Cmd is down
      const focused = event.target.closest?.("[data-press], [data-stop]");
      if (focused && event.key === "Enter") {
        event.preventDefault();
        if (event.repeat) return;
        if (focused.matches("[data-stop]")) stop();
        else press(focused, event.code, event.shiftKey);
        return;
      }
      const way = ARROWS[event.key];
      if (!way || typing(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      if (!event.repeat) pressChosen(way, event.code, event.shiftKey);
    },
    true,
  );
  document.addEventListener(
    "keyup",
    (event) => {
      if (held?.by === event.code) letGo();
      if (event.code !== "Space" || !spaceStopped) return;
      spaceStopped = false;
      event.preventDefault(); // Firefox would click what has the focus,
      event.stopPropagation(); // and the page's framework change a checkbox
    },
    true,
  );

  // ---- whatever takes the page away from its user

  function away() {
    letGo();
    spaceStopped = false; // it comes up elsewhere
  }
  window.addEventListener("blur", away);
  window.addEventListener("pagehide", away);
  document.addEventListener("visibilitychange", () => document.hidden && away());

  // Enter in a field of a request sends that request.
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || event.repeat || !event.target.matches?.("input[name]")) return;
    const name = event.target.name;
    const element = mountOf(event.target)?.root.querySelector(`[data-enter~="${name}"]`);
    if (element && !element.disabled) request(element);
  });

  window.mountSend = (message) => mounts[0]?.send(message); // a click on the picture (camera.js)
  window.mountTick = (number) => mounts[number]?.tick ?? null; // for what NiceGUI's own buttons ask
  window.mountPress = pressChosen; // for a gamepad (gamepad.js)
  window.mountHeld = () => held?.by;
  window.mountRelease = letGo;
  window.mountStop = stop;

  begin();
})();
