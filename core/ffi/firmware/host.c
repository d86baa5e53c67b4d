/* The vectors on this machine. */
#include <stdio.h>

#include "vectors.h"

void write_line(const char *line) { puts(line); }

int main(void) { return vectors(); }
