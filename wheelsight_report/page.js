"use strict";
// What the page holds deflated and in base64, as bytes.
const unpack = async (text) => {
  const bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
const drawPlots = async () => {
  const plots = [...document.querySelectorAll(".plot")];
  if (typeof DecompressionStream === "undefined") {
    for (const plot of plots) {
      plot.className = "plot missing";
      plot.textContent = "This figure needs a browser of 2023 or later; the numbers and pictures do not.";
    }
    return;
  }
  const library = document.createElement("script");
  library.textContent = new TextDecoder().decode(await unpack(document.getElementById("plotly").textContent));
  document.head.append(library);
  const config = { responsive: true, displayModeBar: false };
  // A finger that moves over a figure scrolls the page; a mouse zooms in, and a double click zooms out again.
  const dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
  for (const plot of plots) {
    const figure = JSON.parse(plot.nextElementSibling.textContent);
    Plotly.newPlot(plot, figure.data, { ...figure.layout, dragmode }, config);
  }
  // Plotly sizes figures for the screen; on paper they get the width that their place has there.
  const paperWidth = (plot) => (plot.closest(".pair, .triple") ? 310 : 660);
  addEventListener("beforeprint", () => plots.forEach((p) => Plotly.relayout(p, { width: paperWidth(p), autosize: false })));
  addEventListener("afterprint", () => plots.forEach((p) => Plotly.relayout(p, { width: null, autosize: true })));
};
drawPlots();
