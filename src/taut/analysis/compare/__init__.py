"""Laws side by side under the same conditions."""
