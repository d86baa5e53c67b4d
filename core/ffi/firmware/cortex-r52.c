/* QEMU's mps3-an536: Cortex-R52, semihosting. */
#include "board.h"

static int semihosting(int operation, const void *argument) {
  register int r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("hlt 0xf000" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

void board_write(const char *text) { semihosting(0x04, text); }

_Noreturn void board_exit(int status) {
  const uint32_t block[2] = {0x20026, (uint32_t)status};
  semihosting(0x20, block);
  for (;;) {
  }
}

/* The generic timer, at 62.5 MHz. */
uint32_t board_clock(void) {
  uint32_t low, high;
  __asm__ volatile("isb\n mrrc p15, 0, %0, %1, c14" : "=r"(low), "=r"(high)::"memory");
  return low;
}

uint32_t board_elapsed(uint32_t before) { return (board_clock() - before) * 16; }

/* Boots in Hyp mode: stack, FPU on (HCPTR lets it pass, CPACR, FPEXC). */
__attribute__((naked, section(".start"), used)) void reset(void) {
  __asm__ volatile(
      "ldr sp, =stack_start\n"
      "mrc p15, 0, r0, c1, c0, 2\n orr r0, r0, #0xf00000\n mcr p15, 0, r0, c1, c0, 2\n isb\n"
      "mov r0, #0x40000000\n vmsr fpexc, r0\n"
      "b %c0" ::"i"(firmware));
}
