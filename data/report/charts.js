// Draws the charts that model/report/charts.py describes.
(() => {
  const charts = JSON.parse(document.getElementById("chart-data").textContent);
  const { colour } = drawing;

  const MODES = { line: "lines", dots: "lines+markers", points: "markers", rings: "markers" };
  const RING = { symbol: "circle-open", size: 12, line: { width: 2 } };
  const MARKERS = { line: {}, dots: { size: 7 }, points: { size: 7, opacity: 0.7 }, rings: RING };

  const bars = (part, chart) => ({
    type: "bar",
    name: part.name,
    x: part.edges.slice(0, -1),
    y: part.counts,
    width: part.counts.map((_, bin) => part.edges[bin + 1] - part.edges[bin]),
    offset: 0,
    opacity: 0.65,
    marker: { color: colour(part.colour), line: { width: 0 } },
    customdata: part.edges.slice(1),
    hovertemplate:
      chart.x_label + " %{x:.4g} to %{customdata:.4g}<br>" + chart.y_label + ": %{y:.6~g}<extra></extra>",
  });

  const curve = (part, chart) => ({
    type: "scatter",
    mode: MODES[part.style],
    name: part.name,
    showlegend: part.name !== "",
    x: part.x,
    y: part.y,
    line: { color: colour(part.colour), width: 1.3 * part.width_pt }, // points to pixels
    marker: { color: colour(part.colour), ...MARKERS[part.style] },
    hovertemplate: chart.x_label + " %{x:.4g}<br>" + chart.y_label + " %{y:.4g}<extra></extra>",
  });

  const upright = (part) => ({
    type: "line",
    name: part.name,
    showlegend: part.name !== "",
    yref: "paper",
    x0: part.x,
    x1: part.x,
    y0: 0,
    y1: 1,
    line: { color: colour(part.colour), width: 1.6, dash: part.dash },
  });

  // An axis that counts has no tick between whole numbers.
  const ticks = (whole, values) => {
    const reach = Math.max(...values) - Math.min(...values);
    return whole && reach < 6 ? { dtick: 1 } : { nticks: 7 };
  };

  const axis = (label, whole, values) => ({
    title: { text: label, font: { size: 13 }, standoff: 8 },
    automargin: true,
    fixedrange: true, // a finger that scrolls the page does not move the chart
    zeroline: false,
    showline: true,
    linecolor: colour("baseline"),
    gridcolor: colour("line"),
    ticks: "outside",
    ticklen: 4,
    tickcolor: colour("baseline"),
    tickfont: { size: 11 },
    ...ticks(whole, values),
  });

  const ofKind = (chart, kind) => chart.parts.filter((part) => part.kind === kind);

  const layout = (chart) => {
    const x = chart.parts.flatMap((part) => part.edges ?? part.x);
    const y = chart.parts.flatMap((part) => (part.kind === "bars" ? [0, ...part.counts] : (part.y ?? [])));
    return {
      ...drawing.layout(),
      margin: { l: 8, r: 8, t: 8, b: 8 },
      barmode: "overlay",
      hovermode: "closest",
      dragmode: false,
      xaxis: { ...axis(chart.x_label, chart.whole_x, x), showgrid: false },
      yaxis: axis(chart.y_label, chart.whole_y, y),
      shapes: ofKind(chart, "upright").map(upright),
      showlegend: true,
      legend: {
        orientation: "h",
        x: 0.5,
        xanchor: "center",
        y: 1.02,
        yanchor: "bottom",
        font: { size: 12 },
        itemclick: false,
        itemdoubleclick: false,
      },
    };
  };

  const traces = (chart) => [
    ...ofKind(chart, "bars").map((part) => bars(part, chart)),
    ...ofKind(chart, "curve").map((part) => curve(part, chart)),
  ];

  drawing.draw(
    [...document.querySelectorAll("[data-chart]")],
    (box) => {
      const chart = charts[box.dataset.chart];
      return [traces(chart), layout(chart), { ...drawing.config, displayModeBar: false }];
    },
    (box) => "The same chart is in the report's folder, as figures/" + box.dataset.chart + ".png.",
  );
})();
