"use strict";
(() => {
  const $ = (selector, from = document) => from.querySelector(selector);
  const all = (selector, from = document) => [...from.querySelectorAll(selector)];

  // Light and dark: the reader's system decides until the button does.
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const root = document.documentElement;
  const theme = (name) => { root.dataset.theme = name; };
  theme(dark.matches ? "dark" : "light");
  dark.addEventListener("change", () => theme(dark.matches ? "dark" : "light"));
  $("#theme").addEventListener("click", () => theme(root.dataset.theme === "dark" ? "light" : "dark"));

  // A click on a column's head sorts by it, again the other way.  Lost rows stay last.
  for (const table of all("table.sortable")) {
    const heads = all("thead th", table), body = table.tBodies[0];
    heads.forEach((head, column) => $("button", head).addEventListener("click", () => {
      const order = head.ariaSort === "descending" ? "ascending" : "descending";
      for (const one of heads) one.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", order);
      const sign = order === "ascending" ? 1 : -1;
      const figure = (row) => Number.parseFloat(row.cells[column].textContent.replace("<", ""));
      const words = (row) => row.cells[column].textContent;
      const known = [...body.rows].filter((row) => !row.classList.contains("lost"));
      const lost = [...body.rows].filter((row) => row.classList.contains("lost"));
      const compared = column === 0
        ? (a, b) => sign * words(a).localeCompare(words(b))
        : (a, b) => Number.isNaN(figure(a)) - Number.isNaN(figure(b)) || sign * (figure(a) - figure(b));
      body.append(...known.sort(compared), ...lost);
    }));
    // On a phone each row of a wide table is a card; its cells say which column they are of.
    for (const row of body.rows) {
      [...row.cells].forEach((cell, column) => {
        if (column) cell.dataset.label = cell.colSpan > 1 ? "" : heads[column].innerText.trim();
      });
    }
    if (heads.length > 3) table.classList.add("cards");
  }

  // Paper shows everything.
  addEventListener("beforeprint", () => all("details").forEach((one) => { one.open = true; }));

  const data = $("#examples");
  if (!data) return;
  const examples = JSON.parse(data.textContent);
  const stage = $(".stage");
  const layers = { before: $(".layer.first"), after: $(".layer.second") };
  const choose = { pair: $("#pair"), before: $("#before"), after: $("#after"), map: $("#map") };
  const slider = $("#slider"), divider = $(".divider"), caption = $("#caption");
  const view = { zoom: 1, x: 0, y: 0 };
  const decoded = new Map();

  // The grey values of an image, 0..255, decoded once.
  function greyOf(pair, label) {
    const key = `${pair} ${label}`;
    if (!decoded.has(key)) {
      decoded.set(key, new Promise((resolve, reject) => {
        const image = new Image();
        image.onload = () => {
          const canvas = document.createElement("canvas");
          canvas.width = image.naturalWidth; canvas.height = image.naturalHeight;
          const context = canvas.getContext("2d", { willReadFrequently: true });
          context.drawImage(image, 0, 0);
          const rgba = context.getImageData(0, 0, canvas.width, canvas.height).data;
          const grey = new Uint8Array(rgba.length / 4);
          for (let i = 0; i < grey.length; i += 1) grey[i] = rgba[4 * i];
          resolve({ width: canvas.width, height: canvas.height, grey });
        };
        image.onerror = () => reject(new Error(`cannot decode ${label}`));
        image.src = examples[pair].images[label];
      }));
    }
    return decoded.get(key);
  }

  const mix = (stops, t) => {
    const at = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return stops[low].map((c, i) => c + (stops[low + 1][i] - c) * (at - low));
  };
  const HEAT = [[0, 0, 0], [70, 16, 92], [170, 45, 80], [240, 120, 35], [252, 235, 140]];
  const COLD_HOT = [[40, 110, 220], [140, 180, 235], [245, 245, 245], [240, 160, 130], [200, 50, 40]];
  const table = (stops) => Array.from({ length: 256 }, (_, i) => mix(stops, i / 255));
  const heat = table(HEAT), coldHot = table(COLD_HOT);

  // A pixel's colour from the value of the image, of the clean and of the noisy one.
  const MAPS = {
    image: (v) => [v, v, v],
    error: (v, clean) => heat[Math.min(255, 2 * Math.abs(v - clean))],
    signed: (v, clean) => coldHot[Math.min(255, Math.max(0, 128 + (v - clean)))],
    ratio: (v, clean, noisy) => v < 3 ? [0, 0, 0]
      : coldHot[Math.round(255 * Math.min(1, Math.max(0, 0.5 + Math.log2(Math.max(noisy, 1) / v) / 4)))],
  };
  const MEANING = {
    image: () => "The images themselves.",
    error: (truth) => `Absolute error against ${truth}: black is none, yellow half of full scale or more.`,
    signed: (truth) => `Image minus ${truth}: blue is too dark, red too bright, white is right.`,
    ratio: () => "Noisy divided by the image: white is 1, red 4 and more, blue a quarter and less; black where the image is dark. What a filter took along shows as structure.",
  };

  async function paint(side) {
    const pair = Number(choose.pair.value), label = choose[side].value, kind = choose.map.value;
    const example = examples[pair];
    const first = Object.keys(example.images)[0];
    const [own, truth, noisy] = await Promise.all(
      [label, example.truth || first, first].map((name) => greyOf(pair, name)));
    if (pair !== Number(choose.pair.value) || label !== choose[side].value || kind !== choose.map.value) return;
    const canvas = $("canvas", layers[side]);
    canvas.width = own.width; canvas.height = own.height;
    const context = canvas.getContext("2d");
    const pixels = context.createImageData(own.width, own.height);
    for (let i = 0; i < own.grey.length; i += 1) {
      const [r, g, b] = MAPS[kind](own.grey[i], truth.grey[i], noisy.grey[i]);
      pixels.data.set([r, g, b, 255], 4 * i);
    }
    context.putImageData(pixels, 0, 0);
    stage.style.aspectRatio = `${own.width} / ${own.height}`;
    const figure = example.psnr[label];
    $(`.tag.${side}`).textContent = label + (figure === undefined ? "" : `, ${figure.toFixed(2)} dB`);
    stage.dataset.painted = String(Number(stage.dataset.painted || 0) + 1);
  }

  function place() {
    const share = Number(slider.value);
    layers.after.style.clipPath = `inset(0 0 0 ${share}%)`;
    divider.style.left = `${share}%`;
    const box = stage.getBoundingClientRect();
    view.x = Math.min(0, Math.max(box.width * (1 - view.zoom), view.x));
    view.y = Math.min(0, Math.max(box.height * (1 - view.zoom), view.y));
    for (const canvas of all("canvas", stage)) {
      canvas.style.transform = `translate(${view.x}px, ${view.y}px) scale(${view.zoom})`;
    }
    stage.classList.toggle("zoomed", view.zoom > 1);
    stage.classList.toggle("pixels", view.zoom >= 3);
    $("#zoom").textContent = `${Math.round(100 * view.zoom)} %`;
  }

  function zoom(factor, x, y) {
    const next = Math.min(16, Math.max(1, view.zoom * factor));
    view.x = x - (x - view.x) * next / view.zoom;
    view.y = y - (y - view.y) * next / view.zoom;
    view.zoom = next;
    place();
  }

  function zoomMiddle(factor) {
    const box = stage.getBoundingClientRect();
    zoom(factor, box.width / 2, box.height / 2);
  }

  function fill() {
    const example = examples[Number(choose.pair.value)];
    for (const side of ["before", "after"]) {
      const kept = choose[side].value;
      choose[side].replaceChildren(...Object.keys(example.images).map((name) => new Option(name, name)));
      if (kept in example.images) choose[side].value = kept;
    }
    return example;
  }

  function update() {
    const truth = examples[Number(choose.pair.value)].truth;
    $("#maps").hidden = !truth; // nothing to compare with
    if (!truth) choose.map.value = "image";
    caption.textContent = MEANING[choose.map.value](truth);
    return Promise.all([paint("before"), paint("after")]);
  }

  examples.forEach((example, index) => choose.pair.append(new Option(example.title, String(index))));
  const labels = Object.keys(fill().images);
  choose.before.value = labels[0];
  choose.after.value = labels[1] || labels[0];
  choose.pair.addEventListener("change", () => { fill(); update(); });
  for (const name of ["before", "after", "map"]) choose[name].addEventListener("change", update);
  slider.addEventListener("input", place);
  addEventListener("resize", place);
  $("#closer").addEventListener("click", () => zoomMiddle(1.5));
  $("#farther").addEventListener("click", () => zoomMiddle(1 / 1.5));
  $("#whole").addEventListener("click", () => { view.zoom = 1; place(); });
  stage.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== stage) return; // the page scrolls on
    event.preventDefault();
    const box = stage.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY / 300), event.clientX - box.left, event.clientY - box.top);
  }, { passive: false });

  let held = null;
  const slideTo = (event) => {
    const box = stage.getBoundingClientRect();
    slider.value = String(Math.min(100, Math.max(0, 100 * (event.clientX - box.left) / box.width)));
    place();
  };
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    held = { x: event.clientX, y: event.clientY };
    if (view.zoom === 1) slideTo(event);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!held) return;
    if (view.zoom === 1) { slideTo(event); return; }
    view.x += event.clientX - held.x; view.y += event.clientY - held.y;
    held = { x: event.clientX, y: event.clientY };
    place();
  });
  for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, () => { held = null; });
  stage.addEventListener("keydown", (event) => {
    const step = 40;
    const moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (event.key === "+" || event.key === "=") zoomMiddle(1.5);
    else if (event.key === "-") zoomMiddle(1 / 1.5);
    else if (event.key === "0") { view.zoom = 1; place(); }
    else if (event.key in moves && view.zoom > 1) { view.x += moves[event.key][0]; view.y += moves[event.key][1]; place(); }
    else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      slider.value = String(Number(slider.value) + (event.key === "ArrowLeft" ? -5 : 5)); place();
    } else return;
    event.preventDefault();
  });
  place();
  update();
})();
