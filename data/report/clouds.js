// Draws the point clouds of model/report/report_scenes.py.
(() => {
  const clouds = JSON.parse(document.getElementById("cloud-data").textContent);
  const colours = JSON.parse(document.getElementById("colour-data").textContent);
  const { colour, say } = drawing;
  const FILES = "The same points are in the report's folder pointclouds, as PLY files";

  const hasWebgl = () => {
    try {
      const canvas = document.createElement("canvas");
      return Boolean(canvas.getContext("webgl") || canvas.getContext("experimental-webgl"));
    } catch {
      return false;
    }
  };

  const byDistance = (cloud) => ({
    color: cloud.distance,
    cmin: 0,
    cmax: colours.far,
    colorscale: colours.distance.map((one, index, all) => [index / (all.length - 1), one]),
  });

  // `distance` is there for the prediction alone.
  const points = (name, list, marker, distance) => ({
    type: "scatter3d",
    mode: "markers",
    name,
    x: list.map((point) => point[0]),
    y: list.map((point) => point[1]),
    z: list.map((point) => point[2]),
    marker: { size: 2.2, opacity: 0.85, line: { width: 0 }, ...marker },
    customdata: distance?.map((metres) => (metres < colours.far ? "" : "at least ") + (100 * metres).toFixed(1)),
    hovertemplate:
      "x %{x:.3f} m<br>y %{y:.3f} m<br>z %{z:.3f} m" +
      (distance ? "<br>%{customdata} cm from the truth" : "") +
      "<extra>" + name + "</extra>",
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
      ...drawing.layout(),
      margin: { l: 0, r: 0, t: 0, b: 0 },
      showlegend: false,
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("baseline"), activecolor: colour("text") },
      uirevision: "kept", // a view that the reader turned to stays when the colours change
      scene: {
        aspectmode: "cube", // the ranges are equally long, so all axes have the same scale
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

  const config = {
    ...drawing.config,
    modeBarButtons: [["orbitRotation", "pan3d", "zoom3d", "resetCameraDefault3d", "toImage"]],
  };
  const cloudOf = (box) => clouds[Number(box.dataset.cloud)];
  const boxes = [...document.querySelectorAll("[data-cloud]")];
  if (!hasWebgl()) {
    const sentence = "This browser offers no WebGL, so the point cloud cannot be drawn here. ";
    for (const box of boxes) say(box, "no-webgl", sentence + FILES + " for MeshLab, Blender or Open3D.");
    return;
  }
  for (const box of boxes.filter((box) => cloudOf(box) === null)) {
    say(box, "empty", "Neither the truth nor the prediction shows an object: there are no points to draw.");
  }
  drawing.draw(
    boxes.filter((box) => cloudOf(box) !== null),
    (box) => {
      const cloud = cloudOf(box);
      const traces = [
        points("truth", cloud.truth, { color: colours.truth }),
        points("prediction", cloud.prediction, byDistance(cloud), cloud.distance),
      ];
      return [traces, layout(cloud), config];
    },
    () => FILES + ".",
  );
})();
