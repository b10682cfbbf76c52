"""The page in the browser: a log is dropped, its columns are chosen, the search is watched, the result explored."""
