// A wall from Unity: add this component to an object, and set `address` to what `coulombus world` prints.
// The object's x follows the handle. ClientWebSocket sends no Origin; the token in the address is the key.
using System;
using System.Globalization;
using System.IO;
using System.Net.WebSockets;
using System.Text;
using System.Threading;
using System.Threading.Tasks;
using UnityEngine;

public class CoulombusWorld : MonoBehaviour
{
    public string address = "ws://127.0.0.1:8643/TOKEN/world";
    public float wallRad = 0.0f, stiffnessNmRad = 2.0f, dampingNmsRad = 0.05f;
    public float unitsPerRad = 1.0f;

    // A message of the gateway; each field of a state is an array, the newest state stands last.
    [Serializable]
    class Message
    {
        public string type, reason;
        public int again;
        public double[] x_rad, world_Nm;
        public long[] sequence, lost;
    }

    readonly CancellationTokenSource end = new CancellationTokenSource();
    readonly ClientWebSocket socket = new ClientWebSocket();
    double xRad;

    async void Start()
    {
        try
        {
            await socket.ConnectAsync(new Uri(address), end.Token);
            await Send("{\"type\":\"hello\",\"states\":true}");
            await Task.WhenAll(Render(), Read());
        }
        catch (OperationCanceledException) { }
        catch (WebSocketException error) { Debug.LogWarning(error.Message); }
    }

    void Update()
    {
        transform.localPosition = new Vector3((float)Volatile.Read(ref xRad) * unitsPerRad, 0, 0);
    }

    void OnDestroy()
    {
        end.Cancel();
        socket.Dispose();
    }

    // A model lives for life_s, so it is sent again and again.
    async Task Render()
    {
        while (socket.State == WebSocketState.Open)
        {
            await Send(string.Format(CultureInfo.InvariantCulture,
                "{{\"type\":\"model\",\"law\":0,\"life_s\":0.2," +
                "\"wall\":{{\"x_rad\":{0},\"K_Nm_rad\":{1},\"B_Nms_rad\":{2}}}}}",
                wallRad, stiffnessNmRad, dampingNmsRad));
            await Task.Delay(20, end.Token);
        }
    }

    async Task Read()
    {
        var part = new byte[65536];
        while (socket.State == WebSocketState.Open)
        {
            var whole = new MemoryStream();
            WebSocketReceiveResult result;
            do
            {
                result = await socket.ReceiveAsync(new ArraySegment<byte>(part), end.Token);
                whole.Write(part, 0, result.Count);
            } while (!result.EndOfMessage);
            if (result.MessageType == WebSocketMessageType.Close)
            {
                Debug.Log(result.CloseStatusDescription);
                return;
            }
            var message = JsonUtility.FromJson<Message>(Encoding.UTF8.GetString(whole.ToArray()));
            if (message.type == "refused" && message.again == 0) Debug.LogWarning(message.reason);
            if (message.type == "states") Volatile.Write(ref xRad, message.x_rad[message.x_rad.Length - 1]);
        }
    }

    Task Send(string text)
    {
        var data = new ArraySegment<byte>(Encoding.UTF8.GetBytes(text));
        return socket.SendAsync(data, WebSocketMessageType.Text, true, end.Token);
    }
}
