/* The 25 clock pulses of an HX711: 24 bits, then gain 128 of channel A for the next value.
 *
 * The clock must not stay high for 60 us or the converter sleeps: interrupts are off while it is
 * high, for less than 2 us. */
#include <util/atomic.h>
#include <util/delay.h>

#include "hx711.h"
#include "pins.h"

#define BITS 24
#define PATIENCE 10 /* calls that a value waits for those of the other converters */

void hx711_begin(void)
{
    CELL_CLOCK_PORT &= (uint8_t)~CELL_CLOCK_BIT;
    CELL_CLOCK_DDR |= CELL_CLOCK_BIT;
    CELL_PULL_UPS(); /* a cell that is not there never has a value */
}

static uint8_t pulse(void)
{
    uint8_t seen;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        CELL_CLOCK_PORT |= CELL_CLOCK_BIT;
        _delay_us(1);
        seen = CELL_DATA_PIN;
        CELL_CLOCK_PORT &= (uint8_t)~CELL_CLOCK_BIT;
    }
    return seen;
}

uint8_t hx711_read(int32_t *counts)
{
    static uint8_t waited;
    uint32_t values[CHANNELS] = {0};
    uint8_t ready = 0;
    for (uint8_t i = 0; i < CHANNELS; i++)
        if (!(CELL_DATA_PIN & CELL_DATA(i))) /* low: there is a value */
            ready |= (uint8_t)(1u << i);
    if (ready == 0 || (ready != (1u << CHANNELS) - 1u && ++waited < PATIENCE))
        return 0;
    waited = 0;
    for (uint8_t bit = 0; bit < BITS; bit++) {
        uint8_t seen = pulse();
        for (uint8_t i = 0; i < CHANNELS; i++)
            values[i] = values[i] << 1 | ((seen & CELL_DATA(i)) != 0);
    }
    pulse();
    for (uint8_t i = 0; i < CHANNELS; i++) {
        if (values[i] & 0x800000UL)
            values[i] |= 0xFF000000UL;
        if (ready >> i & 1)
            counts[i] = (int32_t)values[i];
    }
    return ready;
}
