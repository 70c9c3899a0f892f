// An example in C++, for Arduino, too: copy touch.h, touch.c, tables.h and this file, as touch.ino, into a folder touch.
// On a computer: make example_cpp, then ./example_cpp, which takes two seconds.

#ifdef ARDUINO
#include <Arduino.h>
static void say(const char *text) { Serial.println(text); }
#else
#include <chrono>
#include <cstdio>
static void say(const char *text) { std::puts(text); }
static unsigned long micros()
{
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return static_cast<unsigned long>(std::chrono::duration_cast<std::chrono::microseconds>(now).count());
}
#endif

#include "touch.h"

static const unsigned long PERIOD_US = static_cast<unsigned long>(1e6 / TOUCH_RATE_HZ);
static float frame[TOUCH_TAXELS];
static unsigned long due; // when the next frame is read
static unsigned long frames;

// Put your sensor here: a frame row by row, readings from 0 to TOUCH_FULL_SCALE.
static void read_frame()
{
    for (int i = 0; i < TOUCH_TAXELS; i++)
        frame[i] = TOUCH_FULL_SCALE * static_cast<float>((frames + static_cast<unsigned long>(i)) % 16) / 16;
    frames++;
}

#if TOUCH_WATCH
static touch_watch_t watch;
static int status;

static void tell(int news, const touch_event_t &event)
{
    if (news == TOUCH_REPORTED || news == TOUCH_CHANGED)
        say(event.label == TOUCH_UNKNOWN ? "unknown" : touch_name(event.label));
    else if (news == TOUCH_ENDED)
        say("ended");
}

// A frame, after so many lost ones.
static void take_frame(unsigned long lost)
{
    touch_event_t event;
    if (lost)
        tell(touch_missed(&watch, static_cast<uint32_t>(lost), &event), event);
    int news = touch_watch(&watch, frame, &event);
    if (news == TOUCH_BAD) // the frame was refused, the status says why: it counts as lost
        news = touch_missed(&watch, 1, &event);
    tell(news, event);
    int before = status;
    status = touch_status(&watch, nullptr);
    for (int bit = 0; bit < TOUCH_REASONS; bit++)
        if (status & ~before & 1 << bit)
            say(touch_reason(bit)); // do not act on touches while it lasts
}
#else
static touch_t touch;
static float probabilities[TOUCH_CLASSES];

// A frame of a touch, which takes two seconds here, or as long as the longest in training: let yours begin and end where
// your sensor says so. A lost frame shortens the touch.
static void take_frame(unsigned long)
{
    int code = touch_push(&touch, frame);
    if (code == TOUCH_BAD)
        say("a frame was refused");
    if (code != TOUCH_LONG && frames % static_cast<unsigned long>(2 * TOUCH_RATE_HZ))
        return;
    int label = touch_label(&touch, probabilities, nullptr);
    say(label < 0 ? "no frame" : touch_name(label));
    touch_init(&touch);
}
#endif

void setup()
{
#ifdef ARDUINO
    Serial.begin(115200);
#endif
#if TOUCH_WATCH
    touch_watch_init(&watch);
#else
    touch_init(&touch);
#endif
    due = micros();
}

// Reads a frame when it is due, TOUCH_RATE_HZ times a second; other work of the loop may take as long as a period.
void loop()
{
    unsigned long late = micros() - due; // also right when micros() overflows
    if (static_cast<long>(late) < 0)
        return;
    unsigned long lost = late / PERIOD_US;
    due += (lost + 1) * PERIOD_US;
    read_frame();
    take_frame(lost);
}

#ifndef ARDUINO
int main()
{
    setup();
    while (frames < static_cast<unsigned long>(2 * TOUCH_RATE_HZ))
        loop();
}
#endif
