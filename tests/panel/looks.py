"""What tests of every page measure in the browser: contrasts, sizes for a finger, what is cut off."""

SYSTEMS = ["light", "dark"]
THEMES = [*SYSTEMS, "night"]
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1600, "height": 1000}

# The contrast (WCAG 2.2) of every text with what is painted behind it. Backgrounds are mixed as they lie on each other.
CONTRASTS = """() => {
  const parse = (text) => {
    const n = text.match(/[\\d.]+/g).map(Number);
    return { rgb: n.slice(0, 3), a: n.length > 3 ? n[3] : 1 };
  };
  const over = (top, under) => top.rgb.map((c, i) => c * top.a + under[i] * (1 - top.a));
  const luminance = (rgb) => {
    const [r, g, b] = rgb.map((c) => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) {
      const c = parse(getComputedStyle(e).backgroundColor);
      if (c.a > 0) layers.push(c);
      if (c.a === 1) break;
    }
    return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const opacity = (element) => {
    let o = 1;
    for (let e = element; e; e = e.parentElement) o *= Number(getComputedStyle(e).opacity);
    return o;
  };
  const poor = [], seen = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const check = (element, text) => {
    const style = getComputedStyle(element);
    if (!element.checkVisibility({ opacityProperty: true, visibilityProperty: true })) return;
    if (element.closest("[class*='-enter-active'], [class*='-leave-active']")) return; // on its way in or out
    if (element.closest(".q-icon, script, style, [aria-hidden=true]") || element.disabled) return;
    const behind = ground(element);
    const ink = parse(style.color);
    const front = over({ rgb: ink.rgb, a: ink.a * opacity(element) }, behind);
    const [light, dark] = [luminance(front), luminance(behind)].sort((a, b) => b - a);
    const ratio = (light + 0.05) / (dark + 0.05);
    const size = parseFloat(style.fontSize), bold = Number(style.fontWeight) >= 700;
    const least = size >= 24 || (bold && size >= 18.66) ? 3 : 4.5;
    seen.push(text);
    if (ratio < least) poor.push(`${ratio.toFixed(2)} < ${least}: ${text.slice(0, 40)}`);
  };
  while (walk.nextNode()) {
    const text = walk.currentNode.textContent.trim();
    if (text) check(walk.currentNode.parentElement, text);
  }
  for (const input of document.querySelectorAll("input:not([type=range])")) if (input.value) check(input, input.value);
  return { poor, seen };
}"""


def dress(page, theme: str) -> None:
    """Give a page of the panel the colours of a theme: as the system has them, or night's."""
    page.emulate_media(color_scheme="dark" if theme == "dark" else "light")
    page.evaluate("(theme) => mountMode(theme === 'night' ? theme : 'auto')", theme)


def settled(page) -> None:
    """Nothing is on its way in or out."""
    page.wait_for_function(
        """document.getAnimations().every((a) => a.playState !== 'running')
            && !document.querySelector("[class*='-enter-active'], [class*='-leave-active']")"""
    )


def assert_readable(page, *texts: str) -> None:
    """Everything in sight can be read, and these texts are among it."""
    settled(page)
    found = page.evaluate(CONTRASTS)
    assert found["poor"] == []
    for text in texts:
        assert any(text in seen for seen in found["seen"]), text


def assert_touchable(page) -> None:
    """Everything that can be touched has 44 px each way."""
    settled(page)
    small = page.evaluate(
        """() => [...document.querySelectorAll(
                "button, [role=button], [role=checkbox], input, select, .q-item--clickable")]
            .filter((e) => e.checkVisibility())
            .map((e) => [e, (e.closest(".q-field__control, .q-checkbox") ?? e).getBoundingClientRect()])
            .filter(([, box]) => box.width < 43.5 || box.height < 43.5)
            .map(([e, box]) => `${box.width} x ${box.height}: ${e.outerHTML.slice(0, 120)}`)"""
    )
    assert small == []


def assert_nothing_cut_off(page) -> None:
    """No part of the page is wider than the window, and no text wider than its box."""
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    cut = page.evaluate(
        """() => [...document.querySelectorAll("main *")]
            .filter((e) => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0)
            .filter((e) => getComputedStyle(e).overflowX !== "visible" && !e.matches("input, .sr-only"))
            .map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert cut == []
