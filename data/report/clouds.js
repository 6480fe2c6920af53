// Draws the point clouds. A box says in data-drawn how it ended: "plotly", "no-webgl", "empty" or "failed".
(() => {
  const clouds = JSON.parse(document.getElementById("cloud-data").textContent);
  const night = matchMedia("(prefers-color-scheme: dark)");
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  const hasWebgl = () => {
    try {
      const canvas = document.createElement("canvas");
      return Boolean(canvas.getContext("webgl") || canvas.getContext("experimental-webgl"));
    } catch {
      return false;
    }
  };

  const say = (box, how, sentence) => {
    box.dataset.drawn = how;
    const line = document.createElement("p");
    line.textContent = sentence;
    box.replaceChildren(line);
  };

  const points = (name, colourName, list) => ({
    type: "scatter3d",
    mode: "markers",
    name,
    x: list.map((point) => point[0]),
    y: list.map((point) => point[1]),
    z: list.map((point) => point[2]),
    marker: { size: 2.2, color: colour(colourName), opacity: 0.85, line: { width: 0 } },
    hovertemplate: "x %{x:.3f} m<br>y %{y:.3f} m<br>z %{z:.3f} m<extra>" + name + "</extra>",
  });

  const layout = (cloud) => {
    const axis = (title, index) => ({
      title: { text: title, font: { size: 13 } },
      range: [cloud.centre[index] - cloud.reach, cloud.centre[index] + cloud.reach],
      nticks: 5,
      tickfont: { size: 10 },
      color: colour("text"),
      gridcolor: colour("line"),
      zeroline: false,
      showbackground: false,
      showspikes: false,
    });
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 },
      paper_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("text") },
      showlegend: false,
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("baseline"), activecolor: colour("text") },
      uirevision: "kept", // the view somebody turned to survives a change of colours
      scene: {
        aspectmode: "cube", // the ranges are equally long, so a metre is as long on every axis
        xaxis: axis("x right, m", 0),
        yaxis: axis("y down, m", 1),
        zaxis: axis("z forward, m", 2),
        camera: {
          up: { x: 0, y: -1, z: 0 },
          eye: { x: -1.0, y: -0.8, z: -2.3 },
          center: { x: -0.05, y: 0.1, z: 0 },
        },
      },
    };
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
    modeBarButtons: [["orbitRotation", "pan3d", "zoom3d", "resetCameraDefault3d", "toImage"]],
  };

  const draw = async (box) => {
    const cloud = clouds[Number(box.dataset.cloud)];
    if (cloud === null) {
      say(box, "empty", "Neither the truth nor the prediction shows an object: there are no points to draw.");
      return;
    }
    const traces = [points("truth", "truth", cloud.truth), points("prediction", "prediction", cloud.prediction)];
    try {
      await Plotly.react(box, traces, layout(cloud), config);
      box.dataset.drawn = "plotly";
    } catch (error) {
      say(box, "failed", "The point cloud could not be drawn (" + error + "). The same points are in the report's folder pointclouds, as PLY files.");
    }
  };

  const boxes = [...document.querySelectorAll("[data-cloud]")];
  if (!hasWebgl()) {
    for (const box of boxes) {
      say(box, "no-webgl", "This browser offers no WebGL, so the point cloud cannot be drawn here. The same points are in the report's folder pointclouds, as PLY files for MeshLab, Blender or Open3D.");
    }
    return;
  }
  const drawAll = () => boxes.forEach(draw);
  for (const box of boxes) box.replaceChildren();
  drawAll();
  night.addEventListener("change", drawAll);
})();
