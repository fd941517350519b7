// A press on what the page itself has just moved is not carried out: it was meant for what stood there before.
//
// The page grows and shrinks under its user: a message comes, a mount above gets another line, letters arrive. STOP never
// moves. What scrolling moves counts as at rest, what appears has moved. See panel.js for the attributes.
// body.steady: the page was built, and stood still.
"use strict";

(() => {
  const DRIVES = "[data-press], [data-send], [data-clicks]";
  const EVERY_MS = 100;
  const JUST_MS = 300; // a person who sees a move takes longer to aim anew
  const MOVED_PX = 6;
  const TOLD_MS = 4000;

  const places = new WeakMap(); // of each element that drives: in the window, in the page, and when it was moved
  let unmeant = null; // what was pressed, from the press to its click
  let told = 0;

  function justMoved(element, now) {
    const { x, y } = element.getBoundingClientRect();
    const [left, top] = [x + scrollX, y + scrollY]; // in the page: what is fixed in the window moves there
    const was = places.get(element);
    const moved =
      !was || Math.min(Math.hypot(x - was.x, y - was.y), Math.hypot(left - was.left, top - was.top)) > MOVED_PX;
    const movedAt = moved ? now : was.movedAt;
    places.set(element, { x, y, left, top, movedAt });
    return now - movedAt < JUST_MS;
  }

  setInterval(() => {
    const now = performance.now();
    const moved = [...document.querySelectorAll(DRIVES)].filter((element) => justMoved(element, now));
    const built = document.body.classList.contains("ready") && document.fonts.status === "loaded";
    if (built && !moved.length) document.body.classList.add("steady");
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
