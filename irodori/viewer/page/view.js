'use strict';
// Points of the scene on the picture and back; z is up, azimuth runs from +x towards +y.
window.Irodori = window.Irodori || {};
(function (I) {
  const RAD = Math.PI / 180;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const along = (a, k, b) => a.map((value, i) => value + k * b[i]);
  I.distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

  function frame(camera) {
    const az = camera.azimuth_deg * RAD, el = camera.elevation_deg * RAD;
    const back = [Math.cos(el) * Math.cos(az), Math.cos(el) * Math.sin(az), Math.sin(el)];
    const right = [-Math.sin(az), Math.cos(az), 0];
    const up = [-Math.sin(el) * Math.cos(az), -Math.sin(el) * Math.sin(az), Math.cos(el)];
    return {back, right, up, eye: along(camera.target_mm, camera.distance_mm, back)};
  }

  const focal = (camera, height) => height / 2 / Math.tan((camera.fov_deg / 2) * RAD);

  // Where a point is on a picture of this size: x, y and depth in mm; null behind the eye.
  I.project = function (camera, point, width, height) {
    const f = frame(camera);
    const d = along(point, -1, f.eye), depth = -dot(d, f.back);
    if (depth <= 0) return null;
    const scale = focal(camera, height) / depth;
    return [width / 2 + dot(d, f.right) * scale, height / 2 - dot(d, f.up) * scale, depth];
  };

  // Where the ray of a pixel meets the horizontal plane at a height; null where it does not, or too far to mean it.
  I.onPlane = function (camera, x, y, width, height, z) {
    const f = frame(camera), k = focal(camera, height);
    const ray = f.back.map((value, i) => -value + (f.right[i] * (x - width / 2) + f.up[i] * (height / 2 - y)) / k);
    const far = (z - f.eye[2]) / ray[2];
    return Number.isFinite(far) && far > 0 && far < 20 * camera.distance_mm ? along(f.eye, far, ray) : null;
  };

  I.orbit = function (camera, azimuth, elevation) {
    camera.azimuth_deg = ((((camera.azimuth_deg + azimuth + 180) % 360) + 360) % 360) - 180;
    camera.elevation_deg = Math.min(89, Math.max(-20, camera.elevation_deg + elevation));
  };

  I.zoom = function (camera, factor) {
    camera.distance_mm = Math.min(5000, Math.max(20, camera.distance_mm * factor));
  };

  // Move the target by pixels of the picture.
  I.pan = function (camera, dx, dy, height) {
    const f = frame(camera), k = camera.distance_mm / focal(camera, height);
    camera.target_mm = along(along(camera.target_mm, -dx * k, f.right), dy * k, f.up).map((one) => Math.min(5000, Math.max(-5000, one)));
  };

  // Steps on the table, in mm: to the right and away from the eye.
  I.onTable = function (camera, right, away) {
    const f = frame(camera);
    const ahead = [-Math.cos(camera.azimuth_deg * RAD), -Math.sin(camera.azimuth_deg * RAD), 0];
    return along(f.right.map((value) => value * right), away, ahead);
  };

  // A camera on the way between two.
  I.between = function (a, b, t) {
    const turn = ((((b.azimuth_deg - a.azimuth_deg + 180) % 360) + 360) % 360) - 180;
    const mix = (from, to) => from + (to - from) * t;
    return {
      target_mm: a.target_mm.map((value, i) => mix(value, b.target_mm[i])), azimuth_deg: a.azimuth_deg + turn * t,
      elevation_deg: mix(a.elevation_deg, b.elevation_deg), distance_mm: a.distance_mm * (b.distance_mm / a.distance_mm) ** t,
      fov_deg: mix(a.fov_deg, b.fov_deg),
    };
  };

  // A round length for the scale bar, at the distance of the target: mm and pixels.
  I.scaleBar = function (camera, height, longest) {
    const perMm = focal(camera, height) / camera.distance_mm;
    const room = longest / perMm, tens = 10 ** Math.floor(Math.log10(room));
    const mm = [5, 2, 1].map((one) => one * tens).find((one) => one <= room);
    return [mm, mm * perMm];
  };
})(window.Irodori);
