"""Records and their files, text of reports, the table of results."""
