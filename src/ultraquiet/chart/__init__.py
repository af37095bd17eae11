"""Charts in a page: what is drawn, as data, and the script that draws it; one component for report and workbench."""
