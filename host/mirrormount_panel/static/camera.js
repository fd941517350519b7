// Pictures of the cameras: asks for the next one when the last is drawn, and draws spot, blobs, target and trail on it.
// An element with data-camera="1" holds the canvas and the lines; data-clicks: a click sends where the spot should go.
"use strict";

(() => {
  const LEAST_MS = 80; // between two pictures
  const AGAIN_MS = 1000; // after a request that failed
  const OLD_S = 2; // a picture of this age is greyed out
  const KEPT = 600; // points of the trail
  const NICE = [1, 2, 5]; // lengths of the scale bar

  const pause = (ms) => new Promise((done) => setTimeout(done, ms));

  function headers() {
    const found = {};
    const page = document.querySelector("[data-page]")?.dataset.page;
    if (page) found["X-Page"] = page;
    const key = localStorage.getItem("mirrormount-key");
    if (key) found["X-Key"] = key;
    return found;
  }

  class View {
    constructor(box) {
      this.box = box;
      this.canvas = box.querySelector("canvas.picture");
      this.profile = box.querySelector("canvas.profile");
      this.cuts = box.querySelector("canvas.cuts");
      this.image = null;
      this.seen = null;
      this.trail = [];
      this.heardAt = performance.now();
      this.failed = "";
      if ("clicks" in box.dataset) this.canvas.addEventListener("click", (event) => this.click(event));
      this.watch();
      setInterval(() => this.tell(), 250); // the age goes on where no picture comes
    }

    async watch() {
      let after = 0;
      while (this.box.isConnected) {
        if (document.querySelector("[data-page]") && !document.body.classList.contains("ready")) {
          await pause(LEAST_MS); // a page that is not connected to its panel sees nothing
          continue;
        }
        const began = performance.now();
        try {
          const query = this.profile ? "&profile" : "";
          const answer = await fetch(`/camera/${this.box.dataset.camera}?after=${after}${query}`, { headers: headers() });
          if (answer.status === 429) {
            await pause(LEAST_MS);
            continue;
          }
          if (!answer.ok) throw new Error(await answer.text());
          const seen = JSON.parse(answer.headers.get("X-Seen"));
          if (answer.status === 200) {
            const image = await createImageBitmap(await answer.blob());
            this.image?.close();
            this.image = image;
            this.profiled = seen.profile ?? null;
            this.cut = seen.cuts ?? [];
            this.exposure = seen.exposure ?? "";
            after = seen.n;
          }
          this.take(seen);
        } catch (error) {
          this.failed = error instanceof TypeError ? "the program does not answer: see that it still runs" : `no picture: ${error.message}`;
          this.tell();
          await pause(AGAIN_MS);
        }
        await pause(Math.max(0, began + LEAST_MS - performance.now()));
      }
    }

    take(seen) {
      if (this.seen && String(seen.size) !== String(this.seen.size)) this.trail = [];
      if (seen.spot && seen.n !== this.seen?.n) this.trail = [...this.trail.slice(1 - KEPT), seen.spot];
      this.seen = seen;
      this.heardAt = performance.now();
      this.failed = "";
      this.tell();
      requestAnimationFrame(() => this.draw());
    }

    // ---- in words

    tell() {
      const seen = this.seen;
      const age = seen?.age === undefined ? null : seen.age + (performance.now() - this.heardAt) / 1000;
      const trouble = this.failed || seen?.trouble || "";
      const old = Boolean(trouble) || age === null || age > OLD_S;
      this.box.classList.toggle("old", old);
      const at = age === null ? "" : ` The picture is ${age < 100 ? age.toFixed(old ? 0 : 1) : Math.round(age)} s old.`;
      this.line(".camera-trouble", trouble ? `${trouble}.${at}` : old && seen ? at : "");
      this.line(".camera-says", old ? "" : (seen?.says ?? ""));
      this.line(".camera-exposure", old ? "" : (this.exposure ?? ""));
      this.line(".camera-off", old ? "" : (seen?.off ?? ""));
      this.line(".camera-doing", seen?.doing ?? "");
      const also = [seen?.also, seen?.note, age === null || old ? "" : `picture ${age.toFixed(1)} s old`];
      this.line(".camera-also", also.filter(Boolean).join("; "));
    }

    line(where, text) {
      const element = this.box.querySelector(where);
      if (element && element.textContent !== text) element.textContent = text;
    }

    // ---- as a picture

    draw() {
      const { image, seen, canvas } = this;
      if (!image || !seen?.size) return;
      const [columns, rows] = seen.size;
      const wide = Math.max(1, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));
      const scale = wide / columns;
      canvas.style.aspectRatio = `${columns} / ${rows}`;
      if (canvas.width !== wide || canvas.height !== Math.round(rows * scale)) {
        canvas.width = wide;
        canvas.height = Math.round(rows * scale);
      }
      const pen = canvas.getContext("2d");
      const at = ([x, y]) => [(x + 0.5) * scale, (y + 0.5) * scale]; // (0, 0) is the middle of the first pixel
      const line = Math.max(1, wide / 420);
      pen.drawImage(image, 0, 0, canvas.width, canvas.height);
      pen.lineWidth = line;
      pen.strokeStyle = "#ff7a66";
      pen.beginPath();
      for (const point of this.trail) pen.lineTo(...at(point));
      pen.stroke();
      pen.strokeStyle = "#8fa3b3";
      for (const [x, y, width, height] of seen.blobs ?? []) this.ring(pen, at([x, y]), [2 * width, 2 * height], scale, [line * 3, line * 3]);
      if (seen.spot) {
        pen.strokeStyle = "#51cf66";
        this.ring(pen, at(seen.spot), [2 * seen.spot[2], 2 * seen.spot[3]], scale, []);
        this.cross(pen, at(seen.spot), 5 * line);
      }
      if (seen.target) {
        pen.strokeStyle = "#4fc0ff";
        this.cross(pen, at(seen.target), 14 * line);
        pen.strokeRect(...at(seen.target).map((middle) => middle - 7 * line), 14 * line, 14 * line);
      }
      if (seen.unit) this.bar(pen, seen.unit, scale, wide, canvas.height);
      if (this.profile) this.drawProfile();
      if (this.cuts) this.drawCuts();
    }

    ring(pen, [x, y], [width, height], scale, dashes) {
      pen.setLineDash(dashes);
      pen.beginPath();
      pen.ellipse(x, y, width * scale, height * scale, 0, 0, 2 * Math.PI);
      pen.stroke();
      pen.setLineDash([]);
    }

    cross(pen, [x, y], reach) {
      pen.beginPath();
      pen.moveTo(x - reach, y);
      pen.lineTo(x + reach, y);
      pen.moveTo(x, y - reach);
      pen.lineTo(x, y + reach);
      pen.stroke();
    }

    // A length in the best unit that is known: a fifth of the picture, rounded down.
    bar(pen, [pixel, name], scale, wide, high) {
      const most = (wide / scale / 5) * pixel;
      const ten = 10 ** Math.floor(Math.log10(most));
      const length = Math.max(...NICE.map((nice) => nice * ten).filter((nice) => nice <= most));
      const long = (length / pixel) * scale;
      const size = Math.max(11, wide / 40);
      const [x, y] = [size, high - size];
      pen.fillStyle = "#000a";
      pen.font = `${size}px system-ui`;
      const text = length >= 1000 && name === "µrad" ? `${length / 1000} mrad` : `${Number(length.toPrecision(1))} ${name}`;
      pen.fillRect(x - size / 2, y - 1.6 * size, Math.max(long, pen.measureText(text).width) + size, 2.2 * size);
      pen.fillStyle = "#fff";
      pen.fillText(text, x, y - size / 2);
      pen.fillRect(x, y - size / 5, long, size / 5);
    }

    // An empty canvas as wide as its place on the page: its pen, width and height.
    empty(canvas, ratio) {
      const wide = Math.round(canvas.clientWidth * (window.devicePixelRatio || 1));
      const high = Math.round(wide / ratio);
      if (canvas.width !== wide) [canvas.width, canvas.height] = [wide, high];
      const pen = canvas.getContext("2d");
      pen.fillStyle = getComputedStyle(canvas).getPropertyValue("--screen");
      pen.fillRect(0, 0, wide, high);
      pen.lineWidth = Math.max(1, wide / 420);
      return [pen, wide, high];
    }

    // Along the longer axis of the beam, left, and the shorter one, right: white dots; Gaussians of the same size: a green line.
    drawCuts() {
      const [pen, wide, high] = this.empty(this.cuts, 3);
      const size = Math.max(11, wide / 50);
      pen.font = `${size}px system-ui`;
      const half = wide / 2;
      const most = Math.max(20, ...this.cut.flatMap((cut) => [...cut.light, ...cut.gaussian])) * 1.4;
      const reach = Math.max(1, ...this.cut.map((cut) => 4.5 * cut.sigma)); // both in one scale
      this.cut.forEach((cut, side) => {
        const x = (at) => side * half + half / 2 + (at / reach) * (half / 2);
        const y = (value) => (high - 1.6 * size) * (1 - value / most);
        pen.strokeStyle = "#51cf66";
        pen.beginPath();
        cut.gaussian.forEach((value, i) => pen.lineTo(x(cut.at[i]), y(value)));
        pen.stroke();
        pen.fillStyle = "#fff";
        const dot = 2.4 * pen.lineWidth;
        cut.light.forEach((value, i) => pen.fillRect(x(cut.at[i]) - dot / 2, y(value) - dot / 2, dot, dot));
        const name = side ? "shorter" : "longer";
        pen.fillText(`${name} axis, at ${cut.angle}°`, side * half + size / 2, 1.3 * size);
        pen.fillText(`−${Math.round(reach)} px`, side * half + size / 2, high - size / 3);
        const end = `${Math.round(reach)} px`;
        pen.fillText(end, (side + 1) * half - pen.measureText(end).width - size / 2, high - size / 3);
        pen.fillStyle = "#51cf66";
        pen.fillText(`Gaussian, D4-sigma ${(4 * cut.sigma).toFixed(1)} px`, side * half + size / 2, 2.6 * size);
      });
    }

    // One row through the spot, or through the brightest place: white; what it would have to exceed: orange.
    drawProfile() {
      const [pen, wide, high] = this.empty(this.profile, 4);
      if (!this.profiled) return;
      const { light, threshold, row } = this.profiled;
      const most = Math.max(20, ...light, ...threshold) * 1.1;
      for (const [values, colour] of [[threshold, "#ffa94d"], [light, "#fff"]]) {
        pen.strokeStyle = colour;
        pen.beginPath();
        values.forEach((value, i) => pen.lineTo((i / (values.length - 1)) * wide, high - (value / most) * high));
        pen.stroke();
      }
      const size = Math.max(11, wide / 50);
      pen.font = `${size}px system-ui`;
      pen.fillStyle = "#fff";
      pen.fillText(`grey values of row ${row}, up to ${Math.round(Math.max(...light))}`, size / 2, 1.3 * size);
      pen.fillStyle = "#ffa94d";
      pen.fillText("threshold", size / 2, 2.6 * size);
    }

    click(event) {
      if (!this.seen?.size) return;
      const [width, height] = this.seen.size;
      const box = this.canvas.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * width - 0.5;
      const y = ((event.clientY - box.top) / box.height) * height - 0.5;
      const inside = (value, size) => Math.round(Math.min(Math.max(value, 0), size - 1) * 10) / 10;
      const place = { x: inside(x, width), y: inside(y, height), width, height };
      window.mountSend?.({ do: "place", camera: this.box.dataset.camera, ...place });
      for (const axis of ["x", "y"]) {
        const field = document.querySelector(`input[name="place_${axis}"]`);
        if (!field) continue;
        field.value = place[axis];
        field.dispatchEvent(new Event("input", { bubbles: true })); // the page's framework keeps a copy
      }
    }
  }

  const known = new WeakSet();
  function look() {
    for (const box of document.querySelectorAll("[data-camera]")) {
      if (known.has(box)) continue;
      known.add(box);
      new View(box);
    }
  }
  new MutationObserver(look).observe(document.documentElement, { childList: true, subtree: true });
  look();
})();
