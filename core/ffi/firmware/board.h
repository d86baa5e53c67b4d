/* What the boards give: text out, the end, a clock that counts instructions under `qemu -icount shift=0`. */
#ifndef BOARD_H
#define BOARD_H
#include <stdint.h>

void board_write(const char *text);
_Noreturn void board_exit(int status);

/* Time in nanoseconds, which is instructions, since `before`, at most 0.67 s ago. */
uint32_t board_clock(void);
uint32_t board_elapsed(uint32_t before);

/* The program; started on the stack from stack_end up to stack_start. */
_Noreturn void firmware(void);
extern uint32_t stack_start[], stack_end[];
#endif
