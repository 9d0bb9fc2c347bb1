// Builds page.html: the page with its style, its program and three.js in one file, which loads nothing else.
// `node build.mjs` writes it; `node build.mjs --check` fails where it is not what the sources give.

import { readFile, writeFile } from "node:fs/promises";
import { build, transform } from "esbuild";

const here = (path) => new URL(path, import.meta.url);
const page = here("page.html");

const bundled = await build({
  entryPoints: [here("src/main.js").pathname],
  bundle: true,
  minify: true,
  write: false,
  format: "iife",
  target: "es2022",
  legalComments: "none",
});
const style = await transform(await readFile(here("src/style.css"), "utf8"), { loader: "css", minify: true });
const licence = await readFile(here("node_modules/three/LICENSE"), "utf8");
const { version } = JSON.parse(await readFile(here("node_modules/three/package.json"), "utf8"));
const notice = `\nBuilt from server/view by \`make viewer\`. It contains three.js ${version}:\n\n${licence.trim()}\n`;

const parts = {
  NOTICE: notice,
  STYLE: style.code.trim(),
  // An end tag within a text of the program would end it.
  PROGRAM: bundled.outputFiles[0].text.trim().replaceAll("</script", "<\\/script"),
};
const template = await readFile(here("src/page.html"), "utf8");
const built = template.replace(/\{\{([A-Z]+)\}\}/g, (_, name) => parts[name]);

if (process.argv.includes("--check")) {
  if ((await readFile(page, "utf8")) !== built) {
    console.error("server/view/page.html is not what its sources give: run `make viewer`");
    process.exit(1);
  }
} else {
  await writeFile(page, built);
  console.log(`page.html: ${(built.length / 1024).toFixed(0)} KiB`);
}
