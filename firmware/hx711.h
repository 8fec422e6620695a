/* HX711 load-cell converters with a common clock. */
#ifndef TENDON_HX711_H
#define TENDON_HX711_H

#include <stdint.h>

#include "protocol.h"

void hx711_begin(void);

/* Read the converters when all of them have a value, or when one keeps the others waiting:
 * 24 bits, two's complement. Returns a bit per converter that gave a new value. */
uint8_t hx711_read(int32_t *counts);

#endif
