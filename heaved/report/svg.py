"""An SVG document made into an element of a page, beside others of its kind. Pure."""

from __future__ import annotations

import re


def embedded(svg: str, key: str) -> str:
    """The element of an SVG document, to be put into a page beside others: ids that nothing refers to are left out, the
    others begin with the figure's key.
    """
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))

    def kept(match: re.Match[str]) -> str:
        return f' id="{key}-{match[1]}"' if match[1] in used else ""

    svg = re.sub(r' id="([^"]*)"', kept, svg)
    svg = re.sub(r'(url\(|href=")#', rf"\1#{key}-", svg)
    # Matplotlib's style sheet would be that of the whole page.
    svg = re.sub(r"<defs>\s*<style[^>]*>(.*?)</style>\s*</defs>", "", svg, count=1, flags=re.DOTALL)
    # Hundredths of a point are finer than any printer; and who lacks the font has another of its width.
    svg = re.sub(r'(?<= d=")[^"]*|(?<= x=")[^"]*|(?<= y=")[^"]*', lambda match: _rounded(match[0]), svg)
    svg = svg.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    head, body = svg.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    assert view is not None
    # Its size is that of the page's column.
    return (
        f'<svg class="figure" role="img" xmlns:xlink="http://www.w3.org/1999/xlink" {view[0]} '
        f'style="stroke-linejoin:round;stroke-linecap:butt">{body}'
    )


def _rounded(numbers: str) -> str:
    return re.sub(r"-?\d+\.\d{3,}", lambda match: f"{float(match[0]):.2f}".rstrip("0").rstrip("."), numbers).replace(
        "\n", ""
    )
