// What all drawings of the page share: its colours, plotly's options, and a sentence in place of a drawing.
// A box says in data-drawn how it ended: "plotly", "no-webgl", "empty" or "failed".
const drawing = (() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  const say = (box, how, sentence) => {
    box.dataset.drawn = how;
    const line = document.createElement("p");
    line.textContent = sentence;
    box.replaceChildren(line);
  };

  // Nothing that plotly can fetch or send: no maps, no MathJax, no link to its makers.
  const config = {
    displaylogo: false,
    responsive: true,
    showLink: false,
    showSendToCloud: false,
    showEditInChartStudio: false,
    plotlyServerURL: "",
    topojsonURL: "",
    typesetMath: false,
    scrollZoom: false,
  };

  const layout = () => ({
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colour("text"), family: getComputedStyle(document.body).fontFamily },
  });

  // Draws into every box, and again when the colours of the page change. `describe` gives traces, layout and
  // options of one box; `elsewhere` says where a reader finds the same data.
  const draw = (boxes, describe, elsewhere) => {
    const one = async (box) => {
      try {
        await Plotly.react(box, ...describe(box));
        box.dataset.drawn = "plotly";
      } catch (error) {
        say(box, "failed", "This could not be drawn (" + error + "). " + elsewhere(box));
      }
    };
    const all = () => boxes.forEach(one);
    for (const box of boxes) box.replaceChildren();
    all();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", all);
  };

  return { colour, say, config, layout, draw };
})();
