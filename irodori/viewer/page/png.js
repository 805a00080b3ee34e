"use strict";
// A text chunk in a PNG: the snapshot carries the state that it was taken of.
window.Irodori = window.Irodori || {};
(function (I) {
  const KEYWORD = "irodori";
  const MAGIC = [137, 80, 78, 71, 13, 10, 26, 10];
  const table = Array.from({ length: 256 }, (_, n) => {
    let c = n;
    for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
    return c >>> 0;
  });

  function crc(bytes) {
    let c = 0xffffffff;
    for (const byte of bytes) c = table[(c ^ byte) & 255] ^ (c >>> 8);
    return (c ^ 0xffffffff) >>> 0;
  }

  // Every chunk as [type, first byte of its data, bytes of data].
  function* chunks(bytes) {
    if (!MAGIC.every((one, i) => bytes[i] === one)) throw new I.Refusal("no_snapshot");
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    for (let at = 8; at + 12 <= bytes.length;) {
      const length = view.getUint32(at);
      yield [String.fromCharCode(...bytes.subarray(at + 4, at + 8)), at + 8, length];
      at += 12 + length;
    }
  }

  // text: Latin-1 characters only.
  I.pngWithText = function (bytes, text) {
    const data = Uint8Array.from(`tEXt${KEYWORD}\0${text}`, (c) => c.charCodeAt(0));
    const chunk = new Uint8Array(data.length + 8);
    const view = new DataView(chunk.buffer);
    view.setUint32(0, data.length - 4);
    chunk.set(data, 4);
    view.setUint32(4 + data.length, crc(data));
    const [, start, length] = chunks(bytes).next().value;
    const cut = start + length + 4;
    const made = new Uint8Array(bytes.length + chunk.length);
    made.set(bytes.subarray(0, cut));
    made.set(chunk, cut);
    made.set(bytes.subarray(cut), cut + chunk.length);
    return made;
  };

  I.textOfPng = function (bytes) {
    for (const [type, start, length] of chunks(bytes)) {
      if (type !== "tEXt") continue;
      const data = bytes.subarray(start, start + length);
      const text = Array.from(data, (c) => String.fromCharCode(c)).join("");
      const sum = new DataView(bytes.buffer, bytes.byteOffset).getUint32(start + length);
      if (text.startsWith(KEYWORD + "\0") && sum === crc(bytes.subarray(start - 4, start + length)))
        return text.slice(KEYWORD.length + 1);
    }
    throw new I.Refusal("no_snapshot");
  };
})(window.Irodori);
