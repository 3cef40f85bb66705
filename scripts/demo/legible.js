// SPDX-License-Identifier: Apache-2.0
// What is hard to read on the open page: contrast below 4.5 (3 for large text, WCAG 2), text below 12 px, controls
// without a name, an id twice, no heading, language or title. Run by the tests; it is no part of the page.
const found = [], parse = (text) => (text.match(/[\d.]+/g) || []).map(Number);
const over = (top, below) => {
  const a = top[3] === undefined ? 1 : top[3];
  return [0, 1, 2].map((i) => top[i] * a + below[i] * (1 - a));
};
const behind = (e) => {
  if (!e) return [255, 255, 255];
  const own = parse(getComputedStyle(e).backgroundColor);
  return own[3] === 0 ? behind(e.parentElement) : over(own, behind(e.parentElement));
};
const light = (rgb) => {
  const part = rgb.slice(0, 3).map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
};
for (const e of document.querySelectorAll("body *")) {
  const style = getComputedStyle(e), box = e.getBoundingClientRect();
  const text = [...e.childNodes].filter((n) => n.nodeType === 3).map((n) => n.textContent.trim()).join("");
  const shown = box.width && style.visibility !== "hidden" && style.display !== "none";
  if (!text || !shown || /SCRIPT|STYLE|OPTION/.test(e.tagName)) continue;
  const back = behind(e), [a, b] = [light(over(parse(style.color), back)), light(back)].sort((x, y) => y - x);
  const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
  const ratio = (a + 0.05) / (b + 0.05);
  if (ratio < (large ? 3 : 4.5)) found.push(`contrast: ${ratio.toFixed(2)} of "${text.slice(0, 30)}"`);
  if (size < 12) found.push(`size: ${size} px of "${text.slice(0, 30)}"`);
}
for (const e of document.querySelectorAll("input, select, button, canvas[tabindex], [role=img], [role=region]")) {
  const labels = e.labels ? [...e.labels].map((label) => label.textContent.trim()).join("") : "";
  const label = e.getAttribute("aria-label") || e.getAttribute("aria-labelledby") || labels
    || (e.tagName === "BUTTON" && e.textContent.trim());
  if (!label) found.push(`label: none of ${e.tagName} ${e.id}`);
}
const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) found.push(`id: ${id} twice`);
if (document.querySelectorAll("h1").length !== 1) found.push("heading: not one h1");
if (!document.documentElement.lang || !document.title) found.push("language or title: none");
return found;
