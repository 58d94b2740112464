"""Operations: what users ask for, and how it becomes requests to the line.

Read `drive_operations` (one drive), `stop_operations` (the stop of one or all) and
`group_operations` (writes to several) first: every face calls them, and each adds to the one
before. `verb_operations` carries out what a person says to one drive. `requests` puts a request
into the line and waits for its end, `request_maker` gives every request its cost, `control_words`
remembers what a quick stop must know, `reports` is what users are told.
"""
