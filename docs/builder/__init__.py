"""What mkdocs needs to know to build the site out of docs/: equations, links to the repository, colours of code."""
