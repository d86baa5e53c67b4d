/* Test vectors: every entry of gedepth_core.h, results as lines of text. The same program on every processor. */
#ifndef VECTORS_H
#define VECTORS_H
#include <stddef.h>
#include <stdint.h>

/* Given by whoever runs the vectors. */
void write_line(const char *line);

/* Prints one line a vector; the number of calls that failed. */
int vectors(void);

/* "name" and a number of so many hexadecimal digits. */
void print_hex(const char *name, uint64_t value, int digits);

/* Deterministic values in [offset, offset + scale), the same on every processor. */
void noise(float *values, size_t count, uint32_t seed, float scale, float offset);

/* Memory for tables and maps, also for the measurements. */
enum { WIDTH = 1242, HEIGHT = 375 };
extern float table_memory[WIDTH * HEIGHT], map_memory[WIDTH * HEIGHT];
#endif
