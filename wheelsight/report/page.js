"use strict";
(() => {
  const plots = [...document.querySelectorAll(".plot")];
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
})();
