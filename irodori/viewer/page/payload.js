// The payload of a page: base64 of a gzip stream with a JSON header and planes; the format is told in payload.py.
"use strict";
var Irodori = Irodori || {};
Irodori.SCHEMA_VERSION = 2;

(function () {
  const MOST_BYTES = 1 << 28;
  const CODES = ["linear", "log", "light", "float"];

  function refuse(found) {
    throw new Error("The data of this page: found " + found + "; accepted: a payload that irodori wrote.");
  }

  function bytesOf(text) {
    let raw;
    try {
      raw = atob(text);
    } catch (_) {
      refuse("text that is not base64");
    }
    const bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return bytes;
  }

  async function unfolded(bytes) {
    if (!window.DecompressionStream) throw new Irodori.Refusal("no_decompression");
    // Fed by hand: a stream that is cut short or damaged ends in an error of the reader, whatever the writer does.
    const stream = new DecompressionStream("gzip");
    const writer = stream.writable.getWriter();
    writer.write(bytes).catch(() => 0);
    writer.close().catch(() => 0);
    const parts = [],
      reader = stream.readable.getReader();
    let total = 0;
    try {
      for (;;) {
        const { done, value } = await reader.read();
        if (done) break;
        parts.push(value);
        total += value.length;
        if (total > MOST_BYTES) break;
      }
    } catch (_) {
      refuse("a stream that does not unfold");
    }
    if (total > MOST_BYTES) refuse("a stream that is too long");
    const all = new Uint8Array(total);
    let at = 0;
    for (const part of parts) {
      all.set(part, at);
      at += part.length;
    }
    return all;
  }

  function headerOf(all) {
    const length = all.length >= 4 ? new DataView(all.buffer).getUint32(0, true) : MOST_BYTES;
    let header = null;
    if (4 + length <= all.length) {
      try {
        header = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(all.subarray(4, 4 + length)));
      } catch (_) {
        header = null;
      }
    }
    if (!header || !Array.isArray(header.planes)) refuse("no header");
    if (header.schema_version !== Irodori.SCHEMA_VERSION)
      refuse("version " + String(header.schema_version).slice(0, 20));
    return [header, 4 + length];
  }

  function isNumbers(list, count) {
    return Array.isArray(list) && list.length === count && list.every(Number.isFinite);
  }

  function check(entry) {
    const whole = (n) => Number.isInteger(n) && n >= 0 && n < MOST_BYTES;
    if (
      !entry ||
      typeof entry.name !== "string" ||
      !Array.isArray(entry.shape) ||
      !entry.shape.length ||
      !entry.shape.every(whole)
    )
      refuse("a plane without a name or a shape");
    const channels = entry.shape[0],
      code = entry.code;
    const low = code === "linear" || code === "light" ? channels : 0;
    if (
      !CODES.includes(code) ||
      !["row", "above"].includes(entry.delta) ||
      !whole(entry.width) ||
      entry.width < 1 ||
      entry.width > 8 ||
      !isNumbers(entry.low, low) ||
      !isNumbers(entry.step, code === "float" ? 0 : channels) ||
      !Number.isFinite(entry.floor)
    )
      refuse("the plane " + entry.name.slice(0, 40) + " in an unknown code");
  }

  // Whole numbers of a plane, from their bytes: lowest bytes first.
  function wholeNumbers(entry, bytes, count) {
    const q = new Float64Array(count);
    let factor = 1;
    for (let byte = 0; byte < entry.width; byte++, factor *= 256) {
      const part = byte * count;
      for (let i = 0; i < count; i++) q[i] += factor * bytes[part + i];
    }
    const row = entry.shape[entry.shape.length - 1];
    for (let i = 0; i < count; i++) {
      const half = Math.floor(q[i] / 2);
      q[i] = q[i] - 2 * half === 1 ? -half - 1 : half;
    }
    if (entry.delta === "above") {
      const rows = entry.shape[entry.shape.length - 2];
      for (let i = 0; i < count; i++) if (Math.floor(i / row) % rows) q[i] += q[i - row];
    }
    for (let i = 0; i < count; i++) if (i % row) q[i] += q[i - 1];
    return q;
  }

  function values(entry, bytes) {
    const count = entry.shape.reduce((a, b) => a * b, 1);
    if (entry.code === "float") {
      const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength),
        out = new Float32Array(count);
      for (let i = 0; i < count; i++) out[i] = view.getFloat32(4 * i, true);
      return out;
    }
    const q = wholeNumbers(entry, bytes, count),
      channels = entry.shape[0],
      each = count / (channels || 1);
    const out = new Float32Array(count),
      { low, step, floor } = entry;
    for (let channel = 0; channel < channels; channel++) {
      for (let i = 0; i < each; i++) {
        const at = channel * each + i;
        if (entry.code === "linear") out[at] = low[channel] + q[at] * step[channel];
        else if (entry.code === "log" || channel === 0)
          q[at] = out[at] = floor * (Math.pow(2, q[at] * step[channel]) - 1);
        else out[at] = (q[i] + floor) * (low[channel] + q[at] * step[channel]);
      }
    }
    return out;
  }

  // From base64 to {header, planes: {name: Float32Array}, shapes: {name: [sizes]}}; throws an Error of one sentence.
  Irodori.readPayload = async function (text) {
    const all = await unfolded(bytesOf(text)),
      [header, start] = headerOf(all);
    const planes = {},
      shapes = {};
    let first = start;
    for (const entry of header.planes) {
      check(entry);
      const size = entry.shape.reduce((a, b) => a * b, 1) * entry.width;
      if (first + size > all.length) refuse("a plane that is cut short");
      planes[entry.name] = values(entry, all.subarray(first, first + size));
      shapes[entry.name] = entry.shape;
      first += size;
    }
    if (first !== all.length) refuse(all.length - first + " bytes after the last plane");
    return { header, planes, shapes };
  };
})();
