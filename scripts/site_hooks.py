"""What MkDocs does not do by itself: links that leave the documentation.

The pages are read in the repository, too, where a link to ``../../results/...`` leads to the file.
On the site it leads to the repository.
"""

import posixpath
import re
from typing import Any

BRANCH = "main"
LINK = re.compile(r"(\]\()([^)\s#:]+)(#[^)\s]*)?(\))")


def on_page_markdown(markdown: str, *, page: Any, config: Any, **_: Any) -> str:
    """Send links that leave the documentation to the repository."""
    return outward(markdown, page.file.src_uri, config.repo_url)


def outward(markdown: str, page: str, repository: str) -> str:
    """Return a page whose relative links out of the documentation lead to the repository.

    Args:
        markdown: The page's text.
        page: Its path within ``docs/``, with slashes.
        repository: Address of the repository's front page.
    """

    def moved(link: re.Match[str]) -> str:
        opening, target, anchor, closing = link.groups()
        inside = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
        if inside == "docs" or inside.startswith("docs/"):
            return link.group()
        return f"{opening}{repository}/blob/{BRANCH}/{inside}{anchor or ''}{closing}"

    return LINK.sub(moved, markdown)
