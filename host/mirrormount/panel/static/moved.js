// A press on what the page itself has just moved is not carried out: it was meant for what stood there before.
//
// The page grows and shrinks under its user: a message comes, a mount above gets another line. STOP never moves.
// What scrolling moves counts as at rest. See panel.js for the attributes.
"use strict";

(() => {
  const DRIVES = "[data-press], [data-send], [data-clicks]";
  const EVERY_MS = 100;
  const JUST_MS = 300; // a person who sees a move takes longer to aim anew
  const MOVED_PX = 6;
  const TOLD_MS = 4000;

  const places = new WeakMap(); // of each element that drives: {x, y, movedAt}
  let begun = false; // the page could drive at the last look
  let unmeant = null; // what was pressed, from the press to its click
  let told = 0;

  // What appears has moved, too. While the page is built all of it does, and none of it can drive.
  function justMoved(element, now) {
    const box = element.getBoundingClientRect();
    const [x, y] = [box.x + scrollX, box.y + scrollY];
    const was = places.get(element);
    const moved = begun && (!was || Math.hypot(x - was.x, y - was.y) > MOVED_PX);
    const movedAt = moved ? now : (was?.movedAt ?? -Infinity);
    places.set(element, { x, y, movedAt });
    return now - movedAt < JUST_MS;
  }

  setInterval(() => {
    const now = performance.now();
    for (const element of document.querySelectorAll(DRIVES)) justMoved(element, now);
    begun ||= document.body.classList.contains("ready");
  }, EVERY_MS);

  function tell() {
    clearTimeout(told);
    document.body.classList.add("moved");
    told = setTimeout(() => document.body.classList.remove("moved"), TOLD_MS);
  }

  document.addEventListener(
    "pointerdown",
    (event) => {
      const element = event.target.closest?.(DRIVES);
      unmeant = element && justMoved(element, performance.now()) ? element : null;
      if (!unmeant) return;
      event.stopImmediatePropagation();
      tell();
    },
    true,
  );
  document.addEventListener(
    "click",
    (event) => {
      if (unmeant?.contains(event.target) && event.detail) event.stopImmediatePropagation();
      unmeant = null;
    },
    true,
  );
})();
