"""The annotator's server: an ASGI app over one source of episodes and one label folder, on loopback.

`session.py` holds what is open, `episodes_api.py` and `labels_api.py` answer the page, `recording.py` streams
an episode to Rerun's viewer, `security.py` guards every request, `serve.py` runs it all.
"""
