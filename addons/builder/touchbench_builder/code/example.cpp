// An example in C++, for Arduino, too: copy touch.h, touch.c, tables.h and this file, as touch.ino, into a folder touch.
// On a computer: make example_cpp, then ./example_cpp.

#ifdef ARDUINO
#include <Arduino.h>
#else
#include <cstdio>
#endif

#include "touch.h"

static touch_t touch;
static float frame[TOUCH_TAXELS], probabilities[TOUCH_CLASSES];
static int frames;

// Put your sensor here: a frame row by row, readings from 0 to TOUCH_FULL_SCALE.
static void read_frame()
{
    for (int i = 0; i < TOUCH_TAXELS; i++)
        frame[i] = TOUCH_FULL_SCALE * static_cast<float>((frames + i) % 16) / 16;
}

void setup()
{
#ifdef ARDUINO
    Serial.begin(115200);
#endif
    touch_init(&touch);
}

// Call it TOUCH_RATE_HZ times a second. Two seconds are a touch here; call touch_init where yours ends.
void loop()
{
    read_frame();
    touch_push(&touch, frame);
    if (++frames % static_cast<int>(2 * TOUCH_RATE_HZ))
        return;
    int label = touch_label(&touch, probabilities, nullptr);
#ifdef ARDUINO
    Serial.println(touch_name(label));
#else
    std::printf("%s\n", touch_name(label));
#endif
    touch_init(&touch);
}

#ifndef ARDUINO
int main()
{
    setup();
    for (int n = 0; n < static_cast<int>(2 * TOUCH_RATE_HZ); n++)
        loop();
}
#endif
