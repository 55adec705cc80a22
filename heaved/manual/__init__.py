"""The manual: topics in Markdown, their tables made from the code's own, shown in a terminal or as man pages."""
