// The map of a mount's named positions: x to the right, y up, in steps, both of one scale. An element of class map-box has
//   data-kept='[["good", 3, -1.25], …]'   the positions (null: not known of that axis)
//   data-at="[3, 0.5, false]"             where the mount is, and whether it moves; null: not known now
// and an svg to draw in. Names are text, never markup.
"use strict";

(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const KEPT = 300; // points of the trail
  const SET = 0.5; // steps: who is elsewhere by so much without a motion has another 0, and no way from there
  const LEAST = 5; // steps from the middle to the edge, at least
  const [LEFT, RIGHT, TOP, BOTTOM] = [44, 12, 12, 24]; // room for the numbers, px
  const TICK_PX = 52; // between two numbers, at least

  const maps = new Map(); // {trail, kept, at, moved, drawn} of each box

  const number = (value) => `${Number(value.toPrecision(10))}`.replace("-", "−");

  function make(kind, attributes, text) {
    const element = document.createElementNS(SVG, kind);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    if (text !== undefined) element.textContent = text;
    return element;
  }

  // The least of 1, 2, 5, 10 … whole steps that leaves room for its numbers.
  function tick(perPx) {
    const least = Math.max(1, TICK_PX * perPx);
    const ten = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((n) => n * ten).find((n) => n >= least * 0.999);
  }

  // What is shown: all points with some room, grown to whole ticks, so that it stays while the mount moves a little.
  function frame(points, wide, high) {
    const spans = [0, 1].map((axis) => {
      const values = points.map((point) => point[axis]);
      const [low, top] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 0];
      return { middle: (low + top) / 2, half: Math.max(LEAST, ((top - low) / 2) * 1.15) };
    });
    const perPx = Math.max((2 * spans[0].half) / wide, (2 * spans[1].half) / high);
    const step = tick(perPx);
    const half = Math.ceil((perPx * wide) / 2 / step) * step;
    const scale = wide / 2 / half; // px a step
    const middle = spans.map((span) => Math.round(span.middle / step) * step);
    return { step, scale, middle, half: [half, high / 2 / scale] };
  }

  function draw(box) {
    const svg = box.querySelector("svg.map");
    const map = maps.get(box);
    if (!svg || !svg.clientWidth) return;
    const size = [svg.clientWidth, svg.clientHeight];
    const [wide, high] = [size[0] - LEFT - RIGHT, size[1] - TOP - BOTTOM];
    const kept = map.kept.filter(([, x, y]) => Number.isFinite(x) && Number.isFinite(y));
    const points = [...kept.map(([, x, y]) => [x, y]), ...map.trail];
    const view = frame(points, wide, high);
    const at = ([x, y]) => [
      LEFT + wide / 2 + (x - view.middle[0]) * view.scale,
      TOP + high / 2 - (y - view.middle[1]) * view.scale,
    ];
    const drawn = JSON.stringify([size, view, map.kept]);
    if (drawn !== map.drawn) {
      map.drawn = drawn;
      svg.setAttribute("viewBox", `0 0 ${size[0]} ${size[1]}`);
      svg.replaceChildren();
      grid(svg, view, at, wide, high);
      places(svg, kept, at, wide);
      map.line = svg.appendChild(make("polyline", { class: "map-trail" }));
      map.here = svg.appendChild(make("g", { class: "map-here" }));
      map.here.append(make("circle", { r: 7 }), make("circle", { r: 2 }));
    }
    map.line.setAttribute("points", map.trail.map((point) => at(point).map((px) => px.toFixed(1)).join(",")).join(" "));
    const last = map.trail[map.trail.length - 1];
    map.here.style.display = last ? "" : "none";
    map.here.classList.toggle("old", !map.at); // the last that was known
    if (last) map.here.setAttribute("transform", `translate(${at(last).map((px) => px.toFixed(1)).join(" ")})`);
  }

  function grid(svg, view, at, wide, high) {
    for (const axis of [0, 1]) {
      const [middle, half] = [view.middle[axis], view.half[axis]];
      for (let n = Math.ceil((middle - half) / view.step - 1e-9); n * view.step <= middle + half + 1e-9; n++) {
        const value = n * view.step;
        const [x, y] = axis ? [LEFT, at([0, value])[1]] : [at([value, 0])[0], TOP + high];
        const end = axis ? { x2: LEFT + wide, y2: y } : { x2: x, y2: TOP };
        svg.append(make("line", { class: value ? "map-grid" : "map-grid zero", x1: x, y1: y, ...end }));
        const place = axis ? { x: x - 6, y: y + 4, "text-anchor": "end" } : { x, y: y + 16, "text-anchor": "middle" };
        svg.append(make("text", { class: "map-tick", ...place }, number(value)));
      }
    }
    svg.append(make("text", { class: "map-tick", x: LEFT + wide - 4, y: TOP + high - 6, "text-anchor": "end" }, "x →"));
    svg.append(make("text", { class: "map-tick", x: LEFT + 5, y: TOP + 11 }, "↑ y"));
  }

  // A dot for each, with its name beside it where that covers no other name or dot: else the name is in the list only.
  function places(svg, kept, at, wide) {
    const taken = kept.map(([, x, y]) => {
      const [px, py] = at([x, y]);
      return [px - 4, py - 4, px + 4, py + 4];
    });
    const free = (box) =>
      box[0] > LEFT && box[2] < LEFT + wide && box[1] > 0 &&
      taken.every((one) => box[0] >= one[2] || box[2] <= one[0] || box[1] >= one[3] || box[3] <= one[1]);
    for (const [name, x, y] of kept) {
      const [px, py] = at([x, y]);
      const dot = svg.appendChild(make("circle", { class: "map-dot", cx: px, cy: py, r: 4 }));
      dot.append(make("title", {}, `${name}: ${number(x)}, ${number(y)}`));
      const label = svg.appendChild(make("text", { class: "map-name" }, name));
      const long = label.getComputedTextLength();
      const box = [[11, -7], [-11 - long, -7], [-long / 2, -24], [-long / 2, 10]]
        .map(([dx, dy]) => [px + dx, py + dy, px + dx + long, py + dy + 14])
        .find(free);
      if (!box) {
        label.remove();
        continue;
      }
      label.setAttribute("x", box[0]);
      label.setAttribute("y", box[1] + 11);
      taken.push(box);
    }
  }

  function read(box) {
    if (!maps.has(box)) {
      maps.set(box, { trail: [], kept: [], at: null, moved: false, drawn: "" });
      new ResizeObserver(() => requestAnimationFrame(() => draw(box))).observe(box);
    }
    const map = maps.get(box);
    map.kept = JSON.parse(box.dataset.kept ?? "[]");
    map.at = JSON.parse(box.dataset.at ?? "null");
    const last = map.trail[map.trail.length - 1];
    const [now, moves] = map.at ? [map.at.slice(0, 2), map.at[2]] : [null, false];
    if (now && String(now) !== String(last)) {
      const set = last && !moves && !map.moved && Math.hypot(now[0] - last[0], now[1] - last[1]) >= SET;
      map.trail = [...(set ? [] : map.trail.slice(1 - KEPT)), now];
    }
    map.moved = moves;
    draw(box);
  }

  const look = () => document.querySelectorAll(".map-box").forEach((box) => maps.has(box) || read(box));
  new MutationObserver((changes) => {
    look();
    for (const box of new Set(changes.filter((one) => one.type === "attributes").map((one) => one.target))) {
      if (box.matches(".map-box")) read(box);
    }
  }).observe(document.documentElement, { subtree: true, childList: true, attributeFilter: ["data-kept", "data-at"] });
  look();
})();
