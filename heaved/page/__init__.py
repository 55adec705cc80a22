"""``heaved page``: one web page for people, in a process of its own that is only another client of the stream."""
