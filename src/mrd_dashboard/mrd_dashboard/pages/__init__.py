"""The pages, as plain functions over a `Dashboard`: each builds its part of the page for one visitor."""
