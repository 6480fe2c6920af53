// Shows one scene at a time of the picture of all scenes (model/judging/scene_sheet.py).
(() => {
  const { src, columns, width, height, texts } = JSON.parse(document.getElementById("scene-data").textContent);
  const box = document.getElementById("scene-box");
  const chooser = document.createElement("input");
  const said = document.createElement("p");
  const canvas = document.createElement("canvas");
  Object.assign(chooser, { type: "range", min: 0, max: texts.length - 1, value: 0 });
  chooser.setAttribute("aria-label", "scene, by accuracy");
  said.setAttribute("aria-live", "polite");
  Object.assign(canvas, { width, height });

  const sheet = new Image();
  const show = () => {
    const place = Number(chooser.value);
    const [left, top] = [(place % columns) * width, Math.floor(place / columns) * height];
    canvas.getContext("2d").drawImage(sheet, left, top, width, height, 0, 0, width, height);
    said.textContent = texts[place];
    box.dataset.drawn = place;
  };
  sheet.onload = show;
  sheet.src = src;
  chooser.oninput = show;
  box.replaceChildren(chooser, said, canvas);
})();
