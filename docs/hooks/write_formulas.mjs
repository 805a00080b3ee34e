// MathML of every formula of the documentation, so that pages need no script to show them.
//   npx --yes --package katex@0.19.1 -- node docs/hooks/write_formulas.mjs
// reads the blocks ```math of docs/**/*.md and writes docs/hooks/formulas.json: TeX -> MathML.
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const hooks = dirname(fileURLToPath(import.meta.url)), docs = dirname(hooks);
// npx puts the folder of the package's commands first on the path; the package lies beside it.
const packages = dirname(process.env.PATH.split(":").find((one) => one.endsWith("node_modules/.bin")));
const katex = createRequire(pathToFileURL(join(packages, "katex", "package.json")))("katex");

const formulas = {};
for (const name of readdirSync(docs, { recursive: true }).sort()) {
  if (!name.endsWith(".md")) continue;
  for (const [, text] of readFileSync(join(docs, name), "utf-8").matchAll(/^```math\n([^]*?)^```/gm)) {
    const tex = text.trim();
    formulas[tex] = katex.renderToString(tex, { output: "mathml", displayMode: true, strict: "error" });
  }
}
writeFileSync(join(hooks, "formulas.json"), JSON.stringify(formulas, null, 1) + "\n");
