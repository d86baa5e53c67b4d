/* QEMU's mps2-an500: Cortex-M7, semihosting. */
#include "board.h"

static int semihosting(int operation, const void *argument) {
  register int r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

void board_write(const char *text) { semihosting(0x04, text); }

_Noreturn void board_exit(int status) {
  const uint32_t block[2] = {0x20026, (uint32_t)status};
  semihosting(0x20, block);
  for (;;) {
  }
}

/* SysTick: 24 bits, counting down, at 25 MHz. */
#define SYST ((volatile uint32_t *)0xe000e010)

uint32_t board_clock(void) { return SYST[2]; }

uint32_t board_elapsed(uint32_t before) { return ((before - SYST[2]) & 0xffffffu) * 40; }

static void hang(void) { board_exit(99); }

_Noreturn static void start(void) {
  SYST[1] = 0xffffff;
  SYST[2] = 0;
  SYST[0] = 5;
  firmware();
}

__attribute__((naked)) void reset(void) {
  /* The FPU on: CPACR. */
  __asm__ volatile(
      "ldr r0, =0xe000ed88\n ldr r1, [r0]\n orr r1, r1, #0xf00000\n str r1, [r0]\n dsb\n isb\n b %c0" ::"i"(start));
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    stack_start, reset, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang};
