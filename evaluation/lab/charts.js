"use strict";
// Images and curves on canvases.

function showImage(canvas, image) {
  canvas.width = image.width;
  canvas.height = image.height;
  const pixels = new ImageData(image.width, image.height);
  const grey = atob(image.grey);
  for (let index = 0; index < grey.length; index++) {
    pixels.data.fill(grey.charCodeAt(index), 4 * index, 4 * index + 3);
    pixels.data[4 * index + 3] = 255;
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
}

// simulated, beside: values at equal steps; lastX: where the last one lies, with its unit.
function showCurves(canvas, simulated, beside, lastX) {
  const style = getComputedStyle(document.body), scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight, text = 14;
  canvas.width = width * scale;
  canvas.height = height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  const all = [...simulated, ...beside];
  const top = Math.max(...all, 0), bottom = Math.min(...all, 0), span = top - bottom || 1;
  const heightOf = value => text + (top - value) / span * (height - 2 * text);
  context.strokeStyle = context.fillStyle = style.getPropertyValue("--line");
  context.strokeRect(.5, text, width - 1, height - 2 * text);
  context.fillStyle = style.color;
  context.font = "11px system-ui, sans-serif";
  context.fillText(top.toPrecision(3), 2, text - 3);
  context.fillText(bottom.toPrecision(3), 2, height - 3);
  context.textAlign = "right";
  context.fillText(lastX, width - 2, height - 3);
  for (const [values, colour] of [[beside, "--beside"], [simulated, "--simulated"]]) {
    context.strokeStyle = style.getPropertyValue(colour);
    context.lineWidth = 1.5;
    context.beginPath();
    values.forEach((value, index) => context.lineTo(index / (values.length - 1) * width, heightOf(value)));
    context.stroke();
  }
}
