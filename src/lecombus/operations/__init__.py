"""Operations: what users ask for, and how it becomes requests to the line.

Read `drive_operations` (one drive) and `group_operations` (several, and the stop) first: every
face calls them. `verb_operations` carries out what a person says to one drive. `requests` puts a
request into the line and waits for its end, `request_maker` gives every request its cost,
`control_words` remembers what a quick stop must know, `reports` is what users are told.
"""
