"""The page that shows observers in a browser while they run. Read `page_server.py` first."""
