// Driving by a gamepad: presses and releases as those of a key (panel.js), for the mount that was touched last.
//
// d-pad or left stick: one of eight directions. Right shoulder held: fine, as Shift. Any face button: STOP.
// A browser tells of no change: the gamepad is looked at in every frame. What is new is at work only when all its sticks
// and buttons were seen at rest: it may have been plugged in with a stick pushed, or drift. So it is when a press has
// ended otherwise than by its own release: by STOP, a page without focus, frames that stall, a lost connection, and by
// a turn to another direction.
"use strict";

(() => {
  const FACES = [0, 1, 2, 3]; // numbers of the standard layout (w3.org/TR/gamepad)
  const [FINE, UP, DOWN, LEFT, RIGHT] = [5, 12, 13, 14, 15];
  const WAYS = ["x:1", "x:1 y:1", "y:1", "x:-1 y:1", "x:-1", "x:-1 y:-1", "y:-1", "x:1 y:-1"]; // anticlockwise
  const REST = 0.2; // of a stick's way, which is 1: at rest below it,
  const PUSHED = 0.5; // pushed from here on,
  const BACK = 0.35; // until it is back below here
  const KEPT = 0.7; // of 45°: a stick keeps its direction until it is farther off it, which half of 45° would be
  const STEADY_MS = 40; // a direction counts when it has stayed: of a diagonal one button comes before the other
  const STALL_MS = 250; // without a frame for so long nobody looks
  const HOLDS = "Gamepad: d-pad or left stick drives, right shoulder: fine, any face button (A, B, X, Y): STOP.";
  const RESTS = "Gamepad: it drives when all its sticks and buttons were let go. Any face button (A, B, X, Y): STOP.";
  const OTHER = "Gamepad: the browser does not know its layout, so it drives nothing. Any of its buttons: STOP.";

  const known = new Map(); // what is known of each gamepad: {by, rested, way, since, pressed, stops}
  let framedAt = -Infinity; // when it was looked last
  let told = "";

  const isDown = (pad, at) => Boolean(pad.buttons[at]?.pressed);
  const isStandard = (pad) => pad.mapping === "standard";
  const atRest = (pad) => pad.axes.every((axis) => Math.abs(axis) < REST) && !pad.buttons.some((button) => button.pressed);

  // The number of the direction in WAYS, null for none. before: the one that it had.
  function wayOf(pad, before) {
    let x = isDown(pad, RIGHT) - isDown(pad, LEFT);
    let y = isDown(pad, UP) - isDown(pad, DOWN);
    if (!x && !y) [x, y] = [pad.axes[0], -pad.axes[1]];
    if (!(Math.hypot(x, y) >= (before === null ? PUSHED : BACK))) return null;
    const eighths = Math.atan2(y, x) / (Math.PI / 4);
    if (before !== null && Math.abs(((eighths - before + 12) % 8) - 4) < KEPT) return before;
    return (Math.round(eighths) + 8) % 8;
  }

  const release = (one) => window.mountHeld() === one.by && window.mountRelease();

  function follow(pad, one, now) {
    const stops = isStandard(pad) ? FACES.some((at) => isDown(pad, at)) : pad.buttons.some((button) => button.pressed);
    if (stops && !one.stops) window.mountStop();
    one.stops = stops;
    const way = isStandard(pad) ? wayOf(pad, one.way) : null;
    if (way !== one.way) [one.way, one.since] = [way, now];
    if (one.pressed !== null && window.mountHeld() !== one.by) [one.pressed, one.rested] = [null, false];
    if (one.pressed !== null && one.pressed !== way) {
      release(one);
      one.pressed = null;
      one.rested &&= way === null; // turned, not let go: each direction on the way would be a press of some steps
    }
    one.rested = (one.rested || atRest(pad)) && document.hasFocus() && !stops;
    if (!one.rested || way === null || one.pressed !== null || now - one.since < STEADY_MS) return;
    window.mountPress(WAYS[way], one.by, isDown(pad, FINE));
    if (window.mountHeld() === one.by) one.pressed = way;
    else one.rested = false; // something else is held, there is no connection, or no mount was touched
  }

  function look() {
    const now = (framedAt = performance.now());
    const pads = new Map();
    for (const pad of navigator.getGamepads()) if (pad?.connected) pads.set(`gamepad ${pad.index} ${pad.id}`, pad);
    for (const [by, one] of known) {
      if (pads.has(by)) continue;
      release(one);
      known.delete(by);
    }
    for (const [by, pad] of pads) {
      const one = known.get(by) ?? { by, rested: false, way: null, since: now, pressed: null, stops: false };
      known.set(by, one);
      follow(pad, one, now);
    }
    tell([...pads.values()]);
    return pads.size;
  }

  function tell(pads) {
    const rested = [...known.values()].some((one) => one.rested);
    const text = !pads.length ? "" : !pads.some(isStandard) ? OTHER : rested ? HOLDS : RESTS;
    if (text === told) return;
    told = text;
    for (const line of document.querySelectorAll("[data-gamepad]")) line.textContent = text;
  }

  let looking = false;
  function everyFrame() {
    looking = look() > 0;
    if (looking) requestAnimationFrame(everyFrame);
  }
  window.addEventListener("gamepadconnected", () => looking || everyFrame());
  window.addEventListener("gamepaddisconnected", look);
  setInterval(() => {
    if (performance.now() - framedAt > STALL_MS) known.forEach(release);
  }, STALL_MS / 2);
})();
