// Draws the point clouds of model/report/report_scenes.py.
(() => {
  const clouds = JSON.parse(document.getElementById("cloud-data").textContent);
  const colours = JSON.parse(document.getElementById("colour-data").textContent);
  const { colour, say } = drawing;
  const FILES = "The same points are in the report's folder pointclouds, as PLY files";

  const EYE = { x: -1.0, y: -0.8, z: -2.3 };

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

  const wall = (name, corners) => ({
    type: "mesh3d",
    name,
    x: corners.map((point) => point[0]),
    y: corners.map((point) => point[1]),
    z: corners.map((point) => point[2]),
    i: [0, 0],
    j: [1, 2],
    k: [2, 3],
    color: colour("baseline"),
    opacity: 0.35,
    hovertemplate: name + "<extra></extra>",
  });

  // The object's own place: that of its mirror image p is on the other side of the relay wall, plane · p = 1.
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const placed = ({ plane }, list) =>
    list.map((point) => {
      const away = (2 * (dot(plane, point) - 1)) / dot(plane, plane);
      return point.map((value, axis) => value - away * plane[axis]);
    });

  // Traces, and whether each belongs to the view of the room or to that of the mirror image.
  const traces = (cloud) => [
    [false, points("truth", cloud.truth, { color: colours.truth })],
    [false, points("prediction", cloud.prediction, byDistance(cloud), cloud.distance)],
    [true, points("truth", placed(cloud, cloud.truth), { color: colours.truth })],
    [true, points("prediction", placed(cloud, cloud.prediction), byDistance(cloud), cloud.distance)],
    [true, points("camera", [[0, 0, 0]], { color: colour("text"), size: 5 })],
    [true, wall("relay wall", cloud.walls[0])],
    [true, wall("middle wall", cloud.walls[1])],
  ];

  // A cube around the camera, the object and its mirror image.
  const roomCube = (cloud) => {
    const shown = [[0, 0, 0], cloud.centre, ...placed(cloud, [cloud.centre])];
    const sides = [0, 1, 2].map((axis) => shown.map((point) => point[axis]));
    const ends = sides.map((side) => [Math.min(...side), Math.max(...side)]);
    const reach = Math.max(...ends.map(([low, high]) => high - low)) / 2 + cloud.reach;
    return { centre: ends.map(([low, high]) => (low + high) / 2), reach };
  };

  const view = (label, cloud, { centre, reach }, eye, isRoom) => {
    const change = { "scene.camera.eye": eye };
    ["xaxis", "yaxis", "zaxis"].forEach((axis, index) => {
      change["scene." + axis + ".range"] = [centre[index] - reach, centre[index] + reach];
    });
    return {
      label,
      method: "update",
      args: [{ visible: traces(cloud).map(([ofRoom]) => ofRoom === isRoom) }, change],
    };
  };

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
      updatemenus: [
        {
          type: "buttons",
          direction: "right",
          x: 0.02,
          y: 0.99,
          xanchor: "left",
          yanchor: "top",
          showactive: false,
          bgcolor: "rgba(0,0,0,0)",
          bordercolor: colour("line"),
          font: { size: 12, color: colour("text") },
          buttons: [
            view("mirror image", cloud, cloud, EYE, false),
            view("room", cloud, roomCube(cloud), { x: 0.6, y: -2.2, z: -1.3 }, true),
          ],
        },
      ],
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("baseline"), activecolor: colour("text") },
      uirevision: "kept", // a view that the reader turned to stays when the colours change
      scene: {
        aspectmode: "cube", // the ranges are equally long, so all axes have the same scale
        xaxis: axis("x right, m", 0),
        yaxis: axis("y down, m", 1),
        zaxis: axis("z forward, m", 2),
        camera: {
          up: { x: 0, y: -1, z: 0 },
          eye: EYE,
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
      const shown = traces(cloud).map(([ofRoom, trace]) => ({ ...trace, visible: !ofRoom }));
      return [shown, layout(cloud), config];
    },
    () => FILES + ".",
  );
})();
